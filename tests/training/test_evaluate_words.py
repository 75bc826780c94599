from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812

from training.evaluate_words import Task, confusion, embedding, intersections_over_unions
from training.lexicon import Floats
from training.pictures import Picture
from worker.encoders.compact import resized
from worker.encoders.compact_fine import FineWords
from worker.encoders.compact_network import CompactNetwork

TASK = Task([0, 1], ["sky", "road"], [[0], [1, 2]], np.eye(3, dtype=np.float32))
"""Two classes, the second of two words."""


def bright_is_sky(picture: Picture, longest: float) -> Floats:
    """One cell for every 4 x 4 pixels: the first word where it is bright, the third where not."""
    light = cv2.resize(resized(picture, longest), None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA) / 255
    light = light.mean(axis=2).astype(np.float32)
    return np.stack([light, np.zeros_like(light), 1 - light], axis=2)


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """White above, black below; labels say so, save for a corner without any and one that says otherwise."""
    for part in ("images", "labels"):
        (tmp_path / "test" / part).mkdir(parents=True)
    pixels = np.zeros((64, 96, 3), np.uint8)
    pixels[:24] = 255
    labels = np.zeros((64, 96), np.uint8)
    labels[24:] = 1
    labels[:4, :4] = 255
    labels[:4, -8:] = 1
    path = tmp_path / "test" / "images" / "street.png"
    cv2.imwrite(str(path), pixels)
    cv2.imwrite(str(tmp_path / "test" / "labels" / "street.png"), labels)
    return path


def test_pixels_are_counted_by_true_and_answered_class(picture: Path) -> None:
    counts = confusion(bright_is_sky, torch.eye(3), TASK, [picture], scale=1)

    assert counts.tolist() == [[24 * 96 - 4 * 4 - 4 * 8, 0], [4 * 8, 40 * 96]]


def test_the_size_at_which_a_picture_is_judged_does_not_change_what_is_counted(picture: Path) -> None:
    for scale in (None, 2.0):
        counts = confusion(bright_is_sky, torch.eye(3), TASK, [picture], scale)
        assert counts.sum() == 64 * 96 - 16
        assert counts.trace() > 0.95 * counts.sum()


def test_the_intersection_over_the_union_of_each_class() -> None:
    shares = intersections_over_unions(np.array([[6, 2, 0], [1, 3, 0], [0, 0, 0]]))

    assert shares[:2].tolist() == [6 / 9, 3 / 6]
    assert np.isnan(shares[2])


def test_the_fine_words_are_judged_where_there_are_some_and_the_words_field_where_not() -> None:
    network, fine = CompactNetwork().eval(), FineWords().eval()
    picture = np.random.default_rng(0).integers(0, 256, (128, 192, 3)).astype(np.uint8)
    batch = torch.from_numpy(picture).permute(2, 0, 1)[None].float() / 255

    with torch.inference_mode():
        plain = embedding(network, None)(picture, 192)
        assert np.allclose(plain, network(batch)[0][0].permute(1, 2, 0), atol=1e-6)
        looks = embedding(network, fine)(picture, 192)
        assert looks.shape == (32, 48, 97)
        views = resized(picture, 144)[:, ::-1].copy(), resized(picture, 240)
        seen = [torch.from_numpy(view).permute(2, 0, 1)[None].float() / 255 for view in views]
        mirrored, larger = (fine(*network.levels(one)) for one in seen)
        parts = [F.interpolate(part, size=(32, 48), mode="bilinear") for part in (mirrored.flip(3), larger)]
        mean = F.normalize(parts[0] + parts[1], dim=1)[0].permute(1, 2, 0)
        assert np.allclose(looks, mean, atol=1e-5)
