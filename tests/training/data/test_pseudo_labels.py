from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.data.images import Pixels, read_labels, read_rgb
from training.data.lexicon import CITYSCAPES_LABELS
from training.data.pseudo_labels import (
    SOFT_LABEL_GRID,
    Floats16,
    label_map_name,
    soft_labels_name,
    write_label_maps,
    write_soft_labels,
)
from training.data.sources import training_images
from training.models.teacher import Teacher

ROAD, SKY = CITYSCAPES_LABELS.index("road"), CITYSCAPES_LABELS.index("sky")


class BrightIsSky(Teacher):
    """The brighter a pixel, the more probable the sky; the darker, the road."""

    def __init__(self) -> None:
        nn.Module.__init__(self)

    def forward(self, images: Tensor) -> Tensor:
        light = F.avg_pool2d(images.mean(dim=1, keepdim=True), 16)
        logits = torch.zeros(1, 19, *light.shape[2:])
        logits[:, SKY], logits[:, ROAD] = 20 * light[:, 0], 20 * (1 - light[:, 0])
        return logits


def test_soft_labels_are_probabilities_over_the_whole_image_and_are_made_once(
    data_folder: Path, tmp_path: Path
) -> None:
    images = training_images(data_folder / "segmentation", "camvid")
    write_soft_labels(BrightIsSky().soft_labels, images, tmp_path)
    probabilities = np.load(tmp_path / soft_labels_name(images[0])).astype(float)

    assert read_rgb(images[0]).shape[:2] == (96, 128)
    assert probabilities.shape == (19, *SOFT_LABEL_GRID)
    np.testing.assert_allclose(probabilities.sum(axis=0), 1, atol=0.01)
    assert (probabilities[:, :18].argmax(axis=0) == SKY).all()
    assert (probabilities[:, 22:].argmax(axis=0) == ROAD).all()
    stamp = (tmp_path / soft_labels_name(images[0])).stat().st_mtime_ns
    write_soft_labels(BrightIsSky().soft_labels, images, tmp_path)
    assert (tmp_path / soft_labels_name(images[0])).stat().st_mtime_ns == stamp


def test_a_run_that_is_stopped_leaves_no_half_written_soft_labels(data_folder: Path, tmp_path: Path) -> None:
    class Stopped(BrightIsSky):
        def soft_labels(self, image: Pixels) -> Floats16:
            raise KeyboardInterrupt

    images = training_images(data_folder / "segmentation", "camvid")
    with pytest.raises(KeyboardInterrupt):
        write_soft_labels(Stopped().soft_labels, images, tmp_path)
    (tmp_path / soft_labels_name(images[0])).with_suffix(".partial").write_bytes(b"half")  # killed while it was written

    write_soft_labels(BrightIsSky().soft_labels, images, tmp_path)

    assert sorted(p.name for p in tmp_path.glob("camvid__*")) == sorted(map(soft_labels_name, images))
    assert all(np.load(tmp_path / soft_labels_name(path)).shape == (19, *SOFT_LABEL_GRID) for path in images)


def test_a_label_map_has_the_classes_that_the_teacher_is_confident_of(data_folder: Path, tmp_path: Path) -> None:
    images = training_images(data_folder / "segmentation", "camvid")

    write_label_maps(BrightIsSky().label_map, images, tmp_path)

    labels = read_labels(tmp_path / label_map_name(images[0]))
    assert labels.shape == (96, 128)
    assert set(np.unique(labels[:40])) <= {SKY, 255}
    assert set(np.unique(labels[56:])) <= {ROAD, 255}
    assert (labels[:40] == SKY).mean() > 0.5
