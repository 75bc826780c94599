from pathlib import Path

import cv2
import numpy as np
import torch
import torch.nn.functional as F  # noqa: N812

from training.data.batches import Batches
from training.data.lexicon import CITYSCAPES_LABELS, Lexicon
from training.data.mix import Mix
from training.data.pseudo_labels import SOFT_LABEL_GRID, soft_labels_name
from training.data.sources import find_sources
from training.losses.distillation import distillation_loss_of
from training.losses.pixel_sampling import draw_pixels, interpolate_at, sample_source

ROAD, SKY = CITYSCAPES_LABELS.index("road"), CITYSCAPES_LABELS.index("sky")


def test_fields_are_interpolated_between_cells_as_a_whole_image_is() -> None:
    torch.manual_seed(0)
    embeddings = F.normalize(torch.randn(2, 5, 7, 3), dim=3)
    pixels = draw_pixels(2, (20, 28), 500, torch.device("cpu"))

    read = interpolate_at(embeddings, pixels, (20, 28))

    enlarged = F.interpolate(embeddings.permute(0, 3, 1, 2), size=(20, 28), mode="bilinear", align_corners=False)
    assert torch.allclose(read, enlarged[pixels.view, :, pixels.row, pixels.column], atol=1e-6)
    assert pixels.view.bincount().tolist() == [500, 500]
    assert set(pixels.row.tolist()) == set(range(20))


def test_soft_labels_are_read_where_a_view_was_cut_from(data_folder: Path, lexicon: Lexicon, tmp_path: Path) -> None:
    """Quarters labelled crosswise, and soft labels that agree: a mirrored or shifted reading would differ."""
    labels = np.zeros((96, 128), np.uint8)
    labels[:48, :64] = labels[48:, 64:] = 1
    probabilities = np.zeros((19, *SOFT_LABEL_GRID), np.float16)
    road = np.kron([[1, 0], [0, 1]], np.ones((20, 20)))
    probabilities[ROAD], probabilities[SKY] = road, 1 - road
    sources = find_sources(data_folder, None)
    for scene in sources["camvid"].scenes:
        cv2.imwrite(str(scene[0].labels), labels)
        np.save(tmp_path / soft_labels_name(scene[0].image), probabilities)
    allowed = distillation_loss_of(lexicon, torch.zeros(len(lexicon.labels), 97)).allowed
    mix = Mix(strong=0, mild=0, labelled=6, labelled_size=(64, 96), labelled_stride=1)

    batch = Batches(sources, lexicon, mix, 3, tmp_path)[0]
    pixels = draw_pixels(6, (64, 96), 1000, torch.device("cpu"))
    soft_labels, inside = sample_source(batch["soft_labels"].float(), batch["to_source"], pixels, (64, 96))

    classes = batch["labelled_classes"][pixels.view, pixels.row, pixels.column].long()
    labelled = inside & (classes >= 0)
    assert float(labelled.float().mean()) > 0.6
    assert float(allowed[classes[labelled], soft_labels[labelled].argmax(dim=1)].float().mean()) > 0.97
    assert bool((classes[~inside] == -1).all())
