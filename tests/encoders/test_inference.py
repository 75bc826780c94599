"""Tensors travel as they are; a body that is no such message is refused, whatever it is."""

import json

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from schemas.errors import BadBody
from schemas.inference import Tensor, model_name, packed, unpacked

TENSORS = st.dictionaries(
    st.from_regex(r"[A-Za-z0-9._-]{1,8}", fullmatch=True),
    st.one_of(
        arrays(np.uint8, array_shapes(max_dims=4, max_side=4)), arrays(np.float32, array_shapes(max_dims=4, max_side=4))
    ),
    max_size=3,
)


@given(TENSORS)
def test_what_was_packed_comes_out_bit_for_bit(tensors: dict[str, Tensor]) -> None:
    length, body = packed("outputs", tensors, {"model_name": "m"})

    said, found = unpacked("outputs", str(length), body)

    assert said["model_name"] == "m"
    assert list(found) == list(tensors)
    for name, tensor in tensors.items():
        assert found[name].dtype == tensor.dtype
        assert found[name].shape == tensor.shape
        assert found[name].tobytes() == tensor.tobytes()
        assert found[name].flags.aligned


@pytest.mark.parametrize("name", ["", "a\nb", "\x1b[2J", "n" * 65, "é"])
def test_a_name_that_a_log_would_not_carry_as_it_is_is_refused(name: str) -> None:
    length, body = packed("inputs", {name: np.zeros(1, np.uint8)}, {})
    with pytest.raises(BadBody, match="names of tensors"):
        unpacked("inputs", str(length), body)


@given(st.binary(max_size=200), st.one_of(st.none(), st.integers(-5, 250).map(str), st.text(max_size=3)))
def test_noise_is_refused(body: bytes, length: str | None) -> None:
    with pytest.raises(BadBody):
        unpacked("inputs", length, body)


@given(st.data())
def test_a_body_that_was_cut_or_has_more_is_refused(data: st.DataObject) -> None:
    length, body = packed("inputs", {"pictures": np.arange(48, dtype=np.uint8).reshape(1, 4, 4, 3)}, {})
    end = data.draw(st.integers(0, len(body) - 1))

    for spoilt in (body[:end], body + b"x"):
        with pytest.raises(BadBody):
            unpacked("inputs", str(length), spoilt)


@pytest.mark.parametrize(
    "spoilt",
    [
        {"datatype": "INT8"},
        {"datatype": ["UINT8"]},
        {"shape": [1, 4, 4, 4]},
        {"shape": [-1, -48]},
        {"shape": [True, 48]},
        {"shape": 48},
        {"parameters": {}},
        {"parameters": {"binary_data_size": 47}},
        {"parameters": {"binary_data_size": "48"}},
        {"parameters": {"binary_data_size": -48}},
        {"parameters": None},
    ],
)
def test_a_tensor_that_is_not_as_it_says_is_refused(spoilt: dict[str, object]) -> None:
    tensor = {"name": "a", "datatype": "UINT8", "shape": [1, 48], "parameters": {"binary_data_size": 48}}
    head = json.dumps({"inputs": [tensor | spoilt]}).encode()

    with pytest.raises(BadBody):
        unpacked("inputs", str(len(head)), head + bytes(48))


def test_a_model_is_its_encoder_and_weights() -> None:
    assert model_name("compact", "ab" * 32) == "compact-abababababab"
