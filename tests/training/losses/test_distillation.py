"""Learning from another network's opinions, and from pixels between cells."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training.data import batches as data
from training.data.images import Image, read_labels, read_rgb
from training.data.lexicon import STREET_WORDS, ClipWords, Lexicon
from training.data.mix import Mix
from training.losses import pixel_sampling as points
from training.losses.distillation import OpinionLoss, opinion_loss_of
from training.models.teacher import (
    OPINION_CELLS,
    Floats16,
    Teacher,
    label_name,
    opinion_name,
    write_labels,
    write_opinions,
)

ROAD, SKY = STREET_WORDS.index("road"), STREET_WORDS.index("sky")
AGREES = torch.tensor([[True, False, False], [False, True, True]])


def test_a_pixel_is_read_between_cells_as_a_segmentation_reads_it() -> None:
    torch.manual_seed(0)
    embeddings = F.normalize(torch.randn(2, 5, 7, 3), dim=3)
    drawn = points.draw(2, (20, 28), 500, torch.device("cpu"))

    read = points.interpolated(embeddings, drawn, (20, 28))

    enlarged = F.interpolate(embeddings.permute(0, 3, 1, 2), size=(20, 28), mode="bilinear", align_corners=False)
    assert torch.allclose(read, enlarged[drawn.view, :, drawn.row, drawn.column], atol=1e-6)
    assert drawn.view.bincount().tolist() == [500, 500]
    assert set(drawn.row.tolist()) == set(range(20))


def test_opinions_are_read_where_a_view_was_cut_from(data_folder: Path, tmp_path: Path) -> None:
    """Quarters labelled crosswise, and a teacher that says the same: a mirrored or shifted reading would differ."""
    labels = np.zeros((96, 128), np.uint8)
    labels[:48, :64] = labels[48:, 64:] = 1
    attributes = np.zeros((19, *OPINION_CELLS), np.float16)
    road = np.kron([[1, 0], [0, 1]], np.ones((20, 20)))
    attributes[ROAD], attributes[SKY] = road, 1 - road
    found = data.sources(data_folder, None)
    for scene in found["camvid"].scenes:
        cv2.imwrite(str(scene[0].labels), labels)
        np.save(tmp_path / opinion_name(scene[0].image), attributes)
    lexicon = Lexicon(ClipWords(data_folder / data.CLIP_FILE), data.classes(data_folder))
    agrees = opinion_loss_of(lexicon, torch.zeros(len(lexicon.words), 97)).agrees
    mix = Mix(strong=0, mild=0, clear=6, clear_size=(64, 96), clear_stride=1)

    batch = data.Batches(found, lexicon, mix, 3, tmp_path)[0]
    drawn = points.draw(6, (64, 96), 1000, torch.device("cpu"))
    opinions, inside = points.read_in_source(batch["clear_opinions"].float(), batch["clear_views"], drawn, (64, 96))

    meanings = batch["clear_meanings"][drawn.view, drawn.row, drawn.column].long()
    taught = inside & (meanings >= 0)
    assert float(taught.float().mean()) > 0.6
    assert float(agrees[meanings[taught], opinions[taught].argmax(dim=1)].float().mean()) > 0.97
    assert bool((meanings[~inside] == -1).all())


def test_without_a_file_there_is_no_opinion_and_without_a_folder_none_is_carried(
    data_folder: Path, tmp_path: Path
) -> None:
    lexicon = Lexicon(ClipWords(data_folder / data.CLIP_FILE), data.classes(data_folder))
    mix = Mix(strong=0, mild=0, clear=2, clear_size=(64, 96))
    found = data.sources(data_folder, None)

    assert not data.Batches(found, lexicon, mix, 3, tmp_path)[0]["clear_opinions"].any()
    assert "clear_opinions" not in data.Batches(found, lexicon, mix, 3)[0]


def test_the_loss_is_the_relative_entropy_over_the_teachers_words() -> None:
    loss = OpinionLoss(torch.eye(3), AGREES, temperature=0.5)
    embeddings = F.normalize(torch.tensor([[1.0, 2.0, 0.5], [0.1, 0.2, 0.9]]), dim=1)
    opinions = torch.tensor([[0.2, 0.5, 0.3], [0.6, 0.4, 0.0]])

    found = loss(embeddings, opinions, torch.tensor([-1, 0]))

    ours = (embeddings / 0.5).softmax(dim=1)
    expected = [(p[p > 0] * (p[p > 0] / q[p > 0]).log()).sum() for p, q in zip(opinions, ours, strict=True)]
    assert float(found) == pytest.approx(float(sum(expected) / 2), rel=1e-5)
    exactly = torch.tensor([1.0, 0.0, 0.0]).div(0.5).softmax(dim=0)[None]
    assert float(loss(torch.eye(3)[:1], exactly, torch.tensor([-1]))) == pytest.approx(0, abs=1e-6)


def test_an_opinion_that_a_label_contradicts_does_not_count_and_neither_does_none() -> None:
    loss = OpinionLoss(torch.eye(3), AGREES, temperature=0.5)
    embeddings = torch.eye(3)[[2]].requires_grad_(True)
    sure_of_the_first, nothing = torch.tensor([[0.95, 0.05, 0.0]]), torch.zeros(1, 3)

    assert float(loss(embeddings, sure_of_the_first, torch.tensor([1])).detach()) == 0
    assert float(loss(embeddings, sure_of_the_first, torch.tensor([0])).detach()) > 1
    none = loss(embeddings, nothing, torch.tensor([0]))
    assert float(none.detach()) == 0
    none.backward()
    assert embeddings.grad is not None


class BrightIsSky(Teacher):
    """As sure of the sky as a place is bright, and of the road as it is dark."""

    def __init__(self) -> None:
        nn.Module.__init__(self)

    def forward(self, images: Tensor) -> Tensor:
        light = F.avg_pool2d(images.mean(dim=1, keepdim=True), 16)
        scores = torch.zeros(1, 19, *light.shape[2:])
        scores[:, SKY], scores[:, ROAD] = 20 * light[:, 0], 20 * (1 - light[:, 0])
        return scores


def test_a_teachers_opinions_are_probabilities_over_the_whole_picture_and_are_made_once(
    data_folder: Path, tmp_path: Path
) -> None:
    images = data.training_images(data_folder / "segmentation", "camvid")
    write_opinions(BrightIsSky(), images, tmp_path)
    attributes = np.load(tmp_path / opinion_name(images[0])).astype(float)

    assert read_rgb(images[0]).shape[:2] == (96, 128)
    assert attributes.shape == (19, *OPINION_CELLS)
    np.testing.assert_allclose(attributes.sum(axis=0), 1, atol=0.01)
    assert (attributes[:, :18].argmax(axis=0) == SKY).all()
    assert (attributes[:, 22:].argmax(axis=0) == ROAD).all()
    stamp = (tmp_path / opinion_name(images[0])).stat().st_mtime_ns
    write_opinions(BrightIsSky(), images, tmp_path)
    assert (tmp_path / opinion_name(images[0])).stat().st_mtime_ns == stamp


def test_a_teacher_that_is_stopped_leaves_no_half_written_opinions(data_folder: Path, tmp_path: Path) -> None:
    class Stopped(BrightIsSky):
        def opinions(self, image: Image) -> Floats16:
            raise KeyboardInterrupt

    images = data.training_images(data_folder / "segmentation", "camvid")
    with pytest.raises(KeyboardInterrupt):
        write_opinions(Stopped(), images, tmp_path)
    (tmp_path / opinion_name(images[0])).with_suffix(".partial").write_bytes(b"half")  # killed while it was written

    write_opinions(BrightIsSky(), images, tmp_path)

    assert sorted(p.name for p in tmp_path.glob("camvid__*")) == sorted(map(opinion_name, images))
    assert all(np.load(tmp_path / opinion_name(path)).shape == (19, *OPINION_CELLS) for path in images)


def test_a_teachers_labels_are_the_words_it_is_sure_of(data_folder: Path, tmp_path: Path) -> None:
    images = data.training_images(data_folder / "segmentation", "camvid")

    write_labels(BrightIsSky(), images, tmp_path)

    labels = read_labels(tmp_path / label_name(images[0]))
    assert labels.shape == (96, 128)
    assert set(np.unique(labels[:40])) <= {SKY, 255}
    assert set(np.unique(labels[56:])) <= {ROAD, 255}
    assert (labels[:40] == SKY).mean() > 0.5
