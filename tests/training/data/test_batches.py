import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from training.data.batches import Batches
from training.data.lexicon import ClipVectors, Lexicon
from training.data.mix import Mix
from training.data.sources import CLIP_FILE, find_classes, find_sources

WITH_PAIRS = Mix(strong=1, mild=1, labelled=3, size=(32, 64), labelled_size=(64, 96))
LABELLED_ONLY = Mix(strong=0, mild=0, labelled=3, labelled_strong=0.5, labelled_size=(64, 96), labelled_stride=1)


@pytest.fixture
def batches(data_folder: Path, lexicon: Lexicon) -> Batches:
    return Batches(find_sources(data_folder, None), lexicon, WITH_PAIRS, seed=1)


def test_labelled_views_are_larger_and_have_labels(batches: Batches, lexicon: Lexicon) -> None:
    for batch in map(batches.__getitem__, range(4)):
        assert batch["images"].shape == (4, 3, 32, 64)
        assert batch["labelled_images"].shape == (3, 3, 64, 96)
        assert batch["labelled_classes"].shape == (3, 16, 24)
        assert batch["labelled_sets"].tolist() == [lexicon.sets.index("camvid")] * 3
        assert bool((batch["labelled_classes"] >= 0).flatten(1).any(dim=1).all())


def test_labels_lie_where_the_image_shows_what_they_name(batches: Batches, lexicon: Lexicon) -> None:
    labels = [each.labels for each in lexicon.classes]
    sky, road = labels.index(("sky",)), labels.index(("road", "street"))

    drawn = [batches[step] for step in range(4)]
    light = torch.cat([batch["labelled_images"].float().mean(dim=1) for batch in drawn])[:, 2::4, 2::4]
    classes = torch.cat([batch["labelled_classes"] for batch in drawn])

    assert {-1, sky, road} >= set(classes.flatten().tolist()) >= {sky, road}
    of_sky, of_road = float(light[classes == sky].mean()), float(light[classes == road].mean())
    assert of_sky > of_road + 30  # drawn brighter by 120


def test_a_batch_without_pairs_has_nothing_else_and_mixes_the_augmentation(data_folder: Path, lexicon: Lexicon) -> None:
    sources = find_sources(data_folder, None)
    batches = Batches(sources, lexicon, LABELLED_ONLY, seed=5)

    assert batches[0].keys() == {"labelled_images", "labelled_classes", "labelled_sets"}
    assert torch.equal(batches[0]["labelled_images"], batches[0]["labelled_images"])
    mild = Batches(sources, lexicon, Mix(strong=0, mild=0, labelled=3, labelled_size=(64, 96)), seed=5)
    assert not torch.equal(mild[0]["labelled_images"], batches[0]["labelled_images"])


def test_foreground_objects_are_pasted_with_their_labels(data_folder: Path) -> None:
    """Two of the streets have a bright truck before a dark building; pasting brings it onto the others' roads."""
    folder = data_folder / "segmentation" / "camvid"
    classes = json.loads((folder / "classes.json").read_text()) | {"3": ["truck"], "4": ["building"]}
    (folder / "classes.json").write_text(json.dumps(classes))
    for number in (0, 1):
        image, labels = np.full((96, 128, 3), 40, np.uint8), np.full((96, 128), 4, np.uint8)
        image[40:60, 50:80], labels[40:60, 50:80] = 250, 3
        cv2.imwrite(str(folder / "train" / "images" / f"{number}.jpg"), image)
        cv2.imwrite(str(folder / "train" / "labels" / f"{number}.png"), labels)
    sources = find_sources(data_folder, None)
    lexicon = Lexicon(ClipVectors(data_folder / CLIP_FILE), find_classes(data_folder))
    of_classes = [each.labels for each in lexicon.classes]
    truck, road = of_classes.index(("truck",)), of_classes.index(("road", "street"))

    def brightness(pasted: float) -> list[tuple[float, float]]:
        """Of truck and road, in every view that shows both."""
        mix = replace(LABELLED_ONLY, labelled_strong=0.0, labelled_pasted=pasted, labelled=24)
        batch = Batches(sources, lexicon, mix, seed=5)[0]
        views = zip(batch["labelled_classes"], batch["labelled_images"].float().mean(dim=1), strict=True)
        return [
            (light[shown == truck].mean().item(), light[shown == road].mean().item())
            for shown, light in views
            if (shown == truck).any() and (shown == road).any()
        ]

    assert not brightness(0.0)
    together = brightness(1.0)
    assert together
    assert all(of_truck > of_road for of_truck, of_road in together)


def test_soft_labels_are_zero_without_a_file_and_absent_without_a_folder(
    data_folder: Path, lexicon: Lexicon, tmp_path: Path
) -> None:
    mix = Mix(strong=0, mild=0, labelled=2, labelled_size=(64, 96))
    sources = find_sources(data_folder, None)

    assert not Batches(sources, lexicon, mix, 3, tmp_path)[0]["soft_labels"].any()
    assert "soft_labels" not in Batches(sources, lexicon, mix, 3)[0]
