from pathlib import Path

import numpy as np
import pytest

from training.data import batches as data
from training.data.lexicon import ClipWords, Lexicon


@pytest.fixture
def clip(data_folder: Path) -> ClipWords:
    return ClipWords(data_folder / data.CLIP_FILE)


def test_a_word_without_a_vector_stands_for_the_mean_of_others(clip: ClipWords) -> None:
    assert clip.sources("vehicle") == ("car", "truck", "bus", "motorcycle")
    assert clip.sources("road") == ("road",)
    assert clip.sources("unicorn") == ()
    assert np.linalg.norm(clip.vector("vehicle")) == pytest.approx(1, abs=1e-5)
    with pytest.raises(KeyError):
        clip.vector("unicorn")


def test_centring_spreads_the_vectors(clip: ClipWords) -> None:
    vectors = clip.matrix(["road", "sky", "tree", "door"])

    assert np.abs(vectors @ vectors.T - np.eye(4)).max() < 0.3  # drawn in a cone of mean cosine 0.8


def spoken_of(lexicon: Lexicon) -> dict[str, set[str]]:
    """For each meaning, by its first word, the words that its labels speak for or against."""
    return {
        meaning.words[0]: {word for word, spoken in zip(lexicon.words, row, strict=True) if spoken}
        for meaning, row in zip(lexicon.meanings, lexicon.known(), strict=True)
    }


def test_a_street_speaks_against_rooms_but_not_against_what_both_have(clip: ClipWords) -> None:
    lexicon = Lexicon(
        clip,
        {
            "street": {0: ["road"], 1: ["building", "wall"], 7: ["unicorn"]},
            "country": {0: ["grass"]},
            "nyuv2": {0: ["floor"], 1: ["window"]},
        },
    )
    spoken = spoken_of(lexicon)

    assert spoken["road"] == spoken["building"] == {"road", "building", "wall", "floor"}
    assert spoken["grass"] == {"grass", "floor"}
    assert spoken["floor"] == spoken["window"] == {"floor", "window", "road", "building", "grass"}


def test_what_lies_behind_speaks_against_what_stands_in_front_and_the_sky_against_everything(clip: ClipWords) -> None:
    lexicon = Lexicon(
        clip,
        {
            "town": {0: ["sky"], 1: ["tree", "grass"], 2: ["building"]},
            "drive": {0: ["cyclist", "bicycle"], 1: ["pole"]},
        },
    )
    spoken = spoken_of(lexicon)

    assert spoken["sky"] == set(lexicon.words)
    assert spoken["tree"] == {"sky", "tree", "grass", "building", "cyclist", "bicycle", "pole"}
    assert spoken["building"] == {"sky", "tree", "grass", "building"}  # a pole before it may have no label there
    assert spoken["pole"] == {"cyclist", "bicycle", "pole"}


def test_label_values_become_meanings_and_others_nothing(clip: ClipWords) -> None:
    lexicon = Lexicon(clip, {"street": {4: ["road"], 7: ["unicorn"], 9: ["building", "wall"]}})

    table = lexicon.table("street")

    assert (table[4], table[7], table[9], table[255]) == (0, -1, 1, -1)
    assert lexicon.members().sum(axis=1).tolist() == [1, 2]
