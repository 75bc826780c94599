"""The table of variants, and an encoder that encodes each picture once."""

import numpy as np
import pytest

from lab.ablate import VARIANTS, Measured, RememberingEncoder, as_markdown
from schemas.image import Image
from schemas.recipe import Channel, DenseCells, Parameters, Verification
from worker.encoders.color import ColorEncoder

PARAMETERS = Parameters(
    channels={"words": Channel(layer="words", words=64), "detail": Channel(layer="detail", words=64)},
    verification=Verification(),
    dense=DenseCells(shares={"words": 0.3, "detail": 0.7}),
    weights={"dense": 0.2, "close": 0.6, "histogram.words": 0.2, "graph": 0.1, "verification": 0.3},
)


def test_each_variant_switches_one_part() -> None:
    assert len({v.name for v in VARIANTS}) == len(VARIANTS)
    changed = {v.name: v.change(PARAMETERS) for v in VARIANTS}
    assert changed["default"] == PARAMETERS
    assert changed["hard assignment"].channels["detail"].assignments == 1
    assert changed["re-ranking without dense cells"].weights["dense"] == 0
    assert changed["re-ranking without dense cells"].weights["close"] == 0
    assert changed["re-ranking without dense cells"].weights["graph"] == 0.1
    assert changed["re-ranking without verification"].verification is None
    assert list(changed["channel words alone"].channels) == ["words"]
    alone = changed["channel detail alone"]
    assert "histogram.words" not in alone.weights
    assert alone.dense is not None
    assert alone.dense.shares == {"detail": 0.7}
    assert changed["histograms alone"].candidates == 0


def test_the_table_pairs_queries() -> None:
    ones, zeros = np.ones((50, 1)), np.zeros((50, 1))
    half = np.repeat([[1.0], [0.0]], 25, axis=0)
    measured = [
        Measured("default", "a", half),
        Measured("default", "b", ones),
        Measured("worse", "a", zeros),
        Measured("worse", "b", ones),
        Measured("only a", "a", half),
    ]
    lines = as_markdown(measured).splitlines()
    assert lines[2].startswith("| default | 50.0 | 100.0 |")
    assert lines[3].startswith("| worse | 0.0 | 100.0 | -25.0 ±")
    assert lines[4].startswith("| only a | 50.0 | - | +0.0 ±0.0")


def test_a_picture_is_encoded_once() -> None:
    encoder = ColorEncoder()
    remembering = RememberingEncoder(encoder)
    image = Image.of(np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8))
    [first] = remembering.encode([image])
    [second] = remembering.encode([image])
    [plain] = encoder.encode([image])
    assert second is first
    assert first.semantic == pytest.approx(plain.semantic)
    remembering.forget()
    [third] = remembering.encode([image])
    assert third is not first
    assert (remembering.name, remembering.digest) == (encoder.name, encoder.digest)
