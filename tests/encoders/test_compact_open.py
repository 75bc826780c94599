"""The built-in encoder whose weights may be used commercially: the same network, by another name."""

import numpy as np
import pytest

from scenes import scene
from schemas.description import DETAIL, SEMANTIC
from schemas.image import Image
from schemas.settings import Settings
from worker.description import vocabularies
from worker.description.presets import PRESETS
from worker.encoders.choosing import make_encoder
from worker.encoders.compact.encoder import CompactEncoder


@pytest.fixture(scope="module")
def encoder() -> CompactEncoder:
    made, segmenter = make_encoder(Settings(encoder="compact-open"), 1)
    assert segmenter is None  # the members of the ensemble learned from data for research
    assert isinstance(made, CompactEncoder)
    return made


def test_it_says_whose_it_is_and_that_it_may_be_sold(encoder: CompactEncoder) -> None:
    other = CompactEncoder(encodes=False, segments=False)
    assert (encoder.name, other.name) == ("compact-open", "compact")
    assert encoder.digest != other.digest
    assert "commercial use is allowed" in encoder.terms
    assert "non-commercial" in other.terms


def test_it_has_the_layers_of_the_other(encoder: CompactEncoder) -> None:
    [field] = encoder.encode([Image.of(scene("mill lane").pixels)])
    assert {name: layer.shape[2] for name, layer in field.layers.items()} == {SEMANTIC: 97, DETAIL: 64}
    assert np.linalg.norm(field.layers[SEMANTIC], axis=2) == pytest.approx(1, abs=1e-3)


def test_it_tells_a_street_from_a_corridor(encoder: CompactEncoder) -> None:
    labels = ["sky", "ceiling"]
    shares = []
    for name in ("mill lane", "east corridor"):
        [field] = encoder.encode([Image.of(scene(name).pixels)])
        top = field.semantic[: field.semantic.shape[0] // 6]
        shares.append((top @ encoder.text_vectors(labels).T).argmax(axis=2).mean())
    assert shares[0] < 0.3
    assert shares[1] > 0.7


@pytest.mark.parametrize("preset", list(PRESETS))
def test_every_preset_has_its_vocabulary(encoder: CompactEncoder, preset: str) -> None:
    assert vocabularies.shipped(encoder.name, preset) is not None
