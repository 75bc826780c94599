from pathlib import Path

import numpy as np
import pytest

from training import data
from training.lexicon import ClipWords, Lexicon


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


def test_a_street_speaks_against_rooms_but_not_against_what_both_have(clip: ClipWords) -> None:
    lexicon = Lexicon(
        clip,
        {
            "street": {0: ["road"], 1: ["building", "wall"], 7: ["unicorn"]},
            "country": {0: ["grass"]},
            "nyuv2": {0: ["floor"], 1: ["window"]},
        },
    )
    known = {
        data_set: {word for word, is_known in zip(lexicon.words, row, strict=True) if is_known}
        for data_set, row in zip(lexicon.sets, lexicon.known(), strict=True)
    }

    assert known["street"] == {"road", "building", "wall", "floor"}
    assert known["country"] == {"grass", "floor"}
    assert known["nyuv2"] == {"floor", "window", "road", "building", "grass"}


def test_label_values_become_meanings_and_others_nothing(clip: ClipWords) -> None:
    lexicon = Lexicon(clip, {"street": {4: ["road"], 7: ["unicorn"], 9: ["building", "wall"]}})

    table = lexicon.table("street")

    assert (table[4], table[7], table[9], table[255]) == (0, -1, 1, -1)
    assert lexicon.members().sum(axis=1).tolist() == [1, 2]
