"""The encoder port as LSeg keeps it."""

import weakref
from pathlib import Path

import numpy as np
import pytest
import torch

from schemas.errors import InvalidParameters, SetupError
from schemas.records import Meaning
from tests.encoders.lseg import small
from worker.description.ports import Encoder
from worker.encoders.lseg.encoder import LsegEncoder, Mode

IMAGES = [small.image(40, 130, 1), small.image(60, 80, 2), small.image(75, 72, 3), small.image(80, 60, 4)]


def encoder(mode: Mode = "windows", batch: int = 0, dtype: torch.dtype | None = None) -> LsegEncoder:
    return LsegEncoder(small.network(small.state()), small.tokenizer(), "d" * 64, mode=mode, batch=batch, dtype=dtype)


def test_it_keeps_the_port() -> None:
    kept: Encoder = encoder()

    assert (kept.name, dict(kept.layers)) == ("lseg", {"semantic": 16})
    assert kept.digest == "d" * 64


def test_fields_come_in_order_at_unit_length() -> None:
    fields = list(encoder().encode(IMAGES))

    assert [field.shape for field in fields] == [(32, 104), (78, 104), (104, 100), (104, 78)]
    for field, image in zip(fields, IMAGES, strict=True):
        assert field.extent == image.extent
        assert field.semantic.dtype == np.float32
        np.testing.assert_allclose(np.linalg.norm(field.semantic, axis=-1), 1, atol=1e-6)


def test_raw_vectors_carry_the_references_factor() -> None:
    lengths = torch.linalg.vector_norm(next(encoder().raw(IMAGES)), dim=-1)

    assert lengths.max() < 14.30
    assert lengths[0, 0] == pytest.approx(14.289, abs=0.01)


@pytest.mark.parametrize("mode", ["windows", "single"])
@pytest.mark.parametrize("batch", [1, 3])
def test_a_field_does_not_depend_on_what_came_with_it(mode: Mode, batch: int) -> None:
    one = encoder(mode, batch)

    together = [field.semantic for field in one.encode(IMAGES)]

    for image, field in zip(IMAGES, together, strict=True):
        assert np.array_equal(next(one.encode([image])).semantic, field)


@pytest.mark.parametrize("mode", ["windows", "single"])
def test_batches_of_any_size_agree(mode: Mode) -> None:
    for one, several in zip(encoder(mode, 1).encode(IMAGES), encoder(mode, 5).encode(IMAGES), strict=True):
        np.testing.assert_allclose(one.semantic, several.semantic, atol=1e-3)


def test_a_single_pass_has_half_the_resolution_and_nearly_the_content() -> None:
    windows, single = (next(encoder(mode).encode(IMAGES[1:])).semantic for mode in ("windows", "single"))

    assert single.shape == (40, 56, 16)
    rows, columns = (np.linspace(0, n - 1, m).round().astype(int) for n, m in ((40, 78), (56, 104)))
    there = single[rows][:, columns]
    upright, turned = ((windows * other).sum(-1).mean() for other in (there, there[:, ::-1]))
    assert upright > turned + 0.05


def test_the_mode_is_part_of_the_digest() -> None:
    assert encoder("single").digest != encoder("windows").digest
    assert len(encoder("single").digest) == 64


def test_fields_are_made_when_they_are_wanted() -> None:
    passes = []
    one = encoder()
    one._network.register_forward_hook(lambda *_: passes.append(1))
    fields = one.encode(IMAGES)

    assert passes == []
    next(fields)
    assert len(passes) == 2  # the first picture's two windows


def test_a_field_that_was_dropped_takes_no_memory() -> None:
    fields = encoder().encode(IMAGES)
    first = next(fields)
    held = weakref.ref(first)
    data = weakref.ref(first.semantic)

    del first

    assert held() is None
    assert data() is None


def test_lower_precision_gives_unit_float32_fields_near_the_exact_ones() -> None:
    exact, low = (next(encoder(dtype=t).encode(IMAGES)).semantic for t in (torch.float32, torch.float16))

    assert low.dtype == np.float32
    assert (exact * low).sum(-1).min() > 0.999


def test_words_become_unit_vectors_wherever_they_stand() -> None:
    vectors = encoder().text_vectors(["road", "a car in the sky", "sky"])

    assert (vectors.shape, vectors.dtype) == ((3, 16), np.dtype(np.float32))
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(encoder().text_vectors(["sky"]), vectors[2:], atol=1e-6)
    assert encoder().text_vectors([]).shape == (0, 16)


def test_unusable_words_are_refused_all_at_once() -> None:
    for act in (encoder().text_vectors, encoder().meanings):
        with pytest.raises(InvalidParameters) as refused:
            act(["road", "  ", "car " * 11, "sky", ""])
        assert [error.parameter for error in refused.value.errors] == ["labels[1]", "labels[2]", "labels[4]"]
        assert "is empty" in refused.value.errors[0].detail
        assert "13 tokens with start and end; 12 fit" in refused.value.errors[1].detail


def test_every_word_means_itself() -> None:
    assert encoder().meanings(["awning"]) == [Meaning("awning", ("awning",), trained=False)]


def test_there_are_no_default_weights() -> None:
    with pytest.raises(SetupError, match="REVISIT_WEIGHTS"):
        LsegEncoder.open(None)


@pytest.mark.parametrize("device", ["cuda:99", "gpu", "meta:oops"])
def test_a_device_that_is_not_there_is_refused_at_the_start(tmp_path: Path, device: str) -> None:
    with pytest.raises(SetupError, match=f"REVISIT_DEVICE={device}"):
        LsegEncoder.open(tmp_path / "unread.ckpt", device=device)
