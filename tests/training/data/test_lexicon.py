from pathlib import Path

import numpy as np
import pytest

from training.data.lexicon import ClipVectors, Lexicon
from training.data.sources import CLIP_FILE


@pytest.fixture
def clip(data_folder: Path) -> ClipVectors:
    return ClipVectors(data_folder / CLIP_FILE)


def test_a_label_without_a_vector_has_the_mean_of_its_stand_ins(clip: ClipVectors) -> None:
    assert clip.sources("vehicle") == ("car", "truck", "bus", "motorcycle")
    assert clip.sources("road") == ("road",)
    assert clip.sources("unicorn") == ()
    assert np.linalg.norm(clip.vector("vehicle")) == pytest.approx(1, abs=1e-5)
    with pytest.raises(KeyError):
        clip.vector("unicorn")


def test_centring_spreads_the_vectors(clip: ClipVectors) -> None:
    vectors = clip.matrix(["road", "sky", "tree", "door"])

    assert np.abs(vectors @ vectors.T - np.eye(4)).max() < 0.3  # drawn in a cone of mean cosine 0.8


def competing_with(lexicon: Lexicon) -> dict[str, set[str]]:
    """For each class, by its first label, the labels that compete in its softmax."""
    return {
        each.labels[0]: {label for label, competes in zip(lexicon.labels, row, strict=True) if competes}
        for each, row in zip(lexicon.classes, lexicon.competing(), strict=True)
    }


def test_outdoor_classes_compete_with_indoor_labels_but_not_with_those_that_both_have(clip: ClipVectors) -> None:
    lexicon = Lexicon(
        clip,
        {
            "street": {0: ["road"], 1: ["building", "wall"], 7: ["unicorn"]},
            "country": {0: ["grass"]},
            "nyuv2": {0: ["floor"], 1: ["window"]},
        },
    )
    competing = competing_with(lexicon)

    assert competing["road"] == competing["building"] == {"road", "building", "wall", "floor"}
    assert competing["grass"] == {"grass", "floor"}
    assert competing["floor"] == competing["window"] == {"floor", "window", "road", "building", "grass"}


def test_background_classes_compete_with_foreground_labels_and_the_sky_with_all(clip: ClipVectors) -> None:
    lexicon = Lexicon(
        clip,
        {
            "town": {0: ["sky"], 1: ["tree", "grass"], 2: ["building"]},
            "drive": {0: ["cyclist", "bicycle"], 1: ["pole"]},
        },
    )
    competing = competing_with(lexicon)

    assert competing["sky"] == set(lexicon.labels)
    assert competing["tree"] == {"sky", "tree", "grass", "building", "cyclist", "bicycle", "pole"}
    assert competing["building"] == {"sky", "tree", "grass", "building"}  # a pole before it may have no label there
    assert competing["pole"] == {"cyclist", "bicycle", "pole"}


def test_label_values_are_mapped_to_classes_and_others_to_none(clip: ClipVectors) -> None:
    lexicon = Lexicon(clip, {"street": {4: ["road"], 7: ["unicorn"], 9: ["building", "wall"]}})

    table = lexicon.table("street")

    assert (table[4], table[7], table[9], table[255]) == (0, -1, 1, -1)
    assert lexicon.allowed().sum(axis=1).tolist() == [1, 2]
