from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor

from training.evaluate_words import Task, confusion, embedding, intersections_over_unions, scaled
from worker.encoders.compact import resized
from worker.encoders.compact_fine import FineWords
from worker.encoders.compact_network import CompactNetwork

TASK = Task([0, 1], ["sky", "road"], [[0], [1, 2]], np.eye(3, dtype=np.float32))
"""Two classes, the second of two words."""


def bright_is_sky(pictures: Tensor) -> Tensor:
    """One cell for every 4 x 4 pixels: the first word where it is bright, the third where not."""
    light = F.avg_pool2d(pictures.mean(dim=1, keepdim=True), 4)
    return torch.cat([light, torch.zeros_like(light), 1 - light], dim=1)


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """White above, black below; labels say so, save for a corner without any and one that says otherwise."""
    for part in ("images", "labels"):
        (tmp_path / "test" / part).mkdir(parents=True)
    pixels = np.zeros((48, 64, 3), np.uint8)
    pixels[:24] = 255
    labels = np.zeros((48, 64), np.uint8)
    labels[24:] = 1
    labels[:4, :4] = 255
    labels[:4, -8:] = 1
    path = tmp_path / "test" / "images" / "street.png"
    cv2.imwrite(str(path), pixels)
    cv2.imwrite(str(tmp_path / "test" / "labels" / "street.png"), labels)
    return path


def test_pixels_are_counted_by_true_and_answered_class(picture: Path) -> None:
    counts = confusion(bright_is_sky, torch.eye(3), TASK, [picture], lambda pixels: pixels)

    assert counts.tolist() == [[24 * 64 - 4 * 4 - 4 * 8, 0], [4 * 8, 24 * 64]]


def test_the_size_at_which_a_picture_is_judged_does_not_change_what_is_counted(picture: Path) -> None:
    for resize in (resized, lambda pixels: scaled(pixels, 2.0)):
        counts = confusion(bright_is_sky, torch.eye(3), TASK, [picture], resize)
        assert counts.sum() == 48 * 64 - 16
        assert counts.trace() > 0.95 * counts.sum()


def test_the_intersection_over_the_union_of_each_class() -> None:
    shares = intersections_over_unions(np.array([[6, 2, 0], [1, 3, 0], [0, 0, 0]]))

    assert shares[:2].tolist() == [6 / 9, 3 / 6]
    assert np.isnan(shares[2])


def test_the_fine_words_are_judged_where_there_are_some_and_the_words_field_where_not() -> None:
    network, fine = CompactNetwork().eval(), FineWords().eval()
    pictures = torch.rand(1, 3, 64, 96)

    with torch.inference_mode():
        both_ways = fine(*network.levels(pictures)) + fine(*network.levels(pictures.flip(3))).flip(3)
        assert torch.allclose(embedding(network, fine)(pictures), F.normalize(both_ways, dim=1), atol=1e-6)
        assert torch.equal(embedding(network, None)(pictures), network(pictures)[0])
