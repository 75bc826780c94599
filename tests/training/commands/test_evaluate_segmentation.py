from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812

from schemas.description import Floats
from training.commands.evaluate_segmentation import Task, class_ious, confusion, ensemble, semantic_field
from training.data.images import Pixels
from worker.encoders.compact.input_size import resized
from worker.encoders.compact.network import CompactNetwork
from worker.encoders.compact.segmentation import IndependentSegmentationNetwork, SegmentationNetwork
from worker.method.unit_length import unit

TASK = Task([0, 1], ["sky", "road"], [[0], [1, 2]], np.eye(3, dtype=np.float32))
"""Two classes, the second of two labels."""


def bright_is_sky(image: Pixels, longest: float) -> Floats:
    """One cell for every 4 x 4 pixels: the first label where it is bright, the third where not."""
    light = cv2.resize(resized(image, longest), None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA) / 255
    light = light.mean(axis=2).astype(np.float32)
    return np.stack([light, np.zeros_like(light), 1 - light], axis=2)


@pytest.fixture
def image(tmp_path: Path) -> Path:
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


def test_pixels_are_counted_by_true_and_predicted_class(image: Path) -> None:
    counts = confusion(bright_is_sky, torch.eye(3), TASK, [image], scale=1)

    assert counts.tolist() == [[24 * 96 - 4 * 4 - 4 * 8, 0], [4 * 8, 40 * 96]]


def test_the_size_at_which_an_image_is_judged_does_not_change_what_is_counted(image: Path) -> None:
    for scale in (None, 2.0):
        counts = confusion(bright_is_sky, torch.eye(3), TASK, [image], scale)
        assert counts.sum() == 64 * 96 - 16
        assert counts.trace() > 0.95 * counts.sum()


def test_the_intersection_over_the_union_of_each_class() -> None:
    ious = class_ious(np.array([[6, 2, 0], [1, 3, 0], [0, 0, 0]]))

    assert ious[:2].tolist() == [6 / 9, 3 / 6]
    assert np.isnan(ious[2])


def test_the_semantic_field_is_judged_as_the_network_gives_it() -> None:
    network = CompactNetwork().eval()
    image = np.random.default_rng(0).integers(0, 256, (128, 192, 3)).astype(np.uint8)

    with torch.inference_mode():
        field = network(as_batch(image))[0][0]
        assert np.allclose(semantic_field(network)(image, 192), field.permute(1, 2, 0), atol=1e-6)


def test_the_ensemble_is_judged_as_the_service_has_it() -> None:
    network, first, second = (
        CompactNetwork().eval(),
        SegmentationNetwork().eval(),
        IndependentSegmentationNetwork().eval(),
    )
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (128, 192, 3)).astype(np.uint8)
    vectors = unit(rng.standard_normal((5, 97)).astype(np.float32))

    with torch.inference_mode():
        judged = ensemble(network, first, [second], vectors)(image, 192)
        outputs = [
            (first(*network.levels(as_batch(resized(image, 144)[:, ::-1]))).flip(3), 1.0),
            (first(*network.levels(as_batch(resized(image, 240)))), 1.0),
            (second(as_batch(resized(image, 240))), 1.4),
            (second(as_batch(resized(image, 288)[:, ::-1])).flip(3), 1.4),
        ]
    total = torch.zeros(1, 97, 32, 48)
    for output, weight in outputs:
        brought = F.interpolate(output, size=(32, 48), mode="bilinear")
        nearest = torch.einsum("nchw,kc->nkhw", brought, torch.from_numpy(vectors)).amax(dim=1)
        total += weight * nearest.mean() ** 6 * brought
    assert np.allclose(judged, F.normalize(total, dim=1)[0].permute(1, 2, 0), atol=1e-4)


def as_batch(image: Pixels) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(image)).permute(2, 0, 1)[None].float() / 255
