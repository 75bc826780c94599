"""Tensors over HTTP: the Open Inference Protocol (KServe v2) with its extension for binary tensors.

A message is a JSON object, whose length a header gives, and the tensors' bytes after it, in the order in which the
object names them. What is here is what a shared encoder needs; other ways to write a tensor are refused.
"""

import json
import re
from collections.abc import Mapping
from math import prod
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from schemas.description import DETAIL, SEMANTIC
from schemas.errors import BadBody

Tensor = npt.NDArray[np.uint8] | npt.NDArray[np.float32]

MEDIA_TYPE = "application/octet-stream"

JSON_LENGTH = "Inference-Header-Content-Length"
"""Header with the number of bytes of the JSON object."""

PIXELS = "pictures"
"""Name of the input: uint8 of shape (n, height, width, 3), RGB; as in ``compact.onnx``, which such a server can run."""

OUTPUTS: Mapping[str, str] = {SEMANTIC: "words", DETAIL: "detail"}
"""Names of the outputs by layer: float32 of shape (n, rows, columns, channels), unit length; as in ``compact.onnx``."""

STRIDE = 8
"""Pixels of the input per cell of the outputs, along each side."""

QUERY_PRIORITY, ENROLMENT_PRIORITY = 1, 2
"""Values of the parameter ``priority``: the lower goes first (Triton's extension for scheduling)."""

SEGMENTED = "segmentation"
"""Name of the output of a segmenter: float32 of shape (1, rows, columns, channels), unit length."""

ROWS, COLUMNS = "rows", "columns"
"""Parameters of a request to a segmenter: the size of the segmentation."""


def scale_name(number: int) -> str:
    """Name of a segmenter's input: the image at one of its scales, from 0 on, as `PIXELS` with n = 1."""
    return f"{PIXELS}.{number}"


PROBE: npt.NDArray[np.uint8] = np.full((1, 96, 96, 3), 127, np.uint8)
"""A small image, grey, by which it is tried whether a server encodes."""

LARGEST_JSON = 64 * 1024
"""Bytes of the JSON object of a message; that of ours has some hundred."""

_NAME = re.compile(r"[A-Za-z0-9._-]{1,64}")

MOST_TENSORS, MOST_DIMENSIONS, LONGEST_SIDE = 16, 8, 2**31

_TYPES: Mapping[str, type] = {"UINT8": np.uint8, "FP32": np.float32}
_NAMES: Mapping[np.dtype[Any], str] = {np.dtype(kind): name for name, kind in _TYPES.items()}


def model_name(encoder: str, digest: str) -> str:
    """Name of a model: encoder and weights. Who asks for other weights than a server has asks for an unknown model."""
    return f"{encoder}-{digest[:12]}"


def segmenter_name(encoder: str, digest: str) -> str:
    """Name of the model that segments: its digest is that of all that decides what is drawn."""
    return f"{encoder}-segmenter-{digest[:12]}"


def packed(
    kind: Literal["inputs", "outputs"], tensors: Mapping[str, Tensor], further: Mapping[str, Any]
) -> tuple[int, bytes]:
    """A message with tensors.

    Parameters
    ----------
    kind : {'inputs', 'outputs'}
    tensors : mapping of name to uint8 or float32 array
    further : mapping
        The other members of the JSON object.

    Returns
    -------
    json_length : int
        For the header `JSON_LENGTH`.
    body : bytes
    """
    described = [
        {
            "name": name,
            "shape": list(tensor.shape),
            "datatype": _NAMES[tensor.dtype],
            "parameters": {"binary_data_size": tensor.nbytes},
        }
        for name, tensor in tensors.items()
    ]
    head = json.dumps({**further, kind: described}, separators=(",", ":")).encode()
    return len(head), b"".join([head, *(np.ascontiguousarray(tensor).data for tensor in tensors.values())])


def unpacked(
    kind: Literal["inputs", "outputs"], json_length: str | None, body: bytes
) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """The JSON object of a message, and its tensors by name.

    Raises
    ------
    BadBody
        It is no such message, or a tensor is of another type, or not sent as bytes.
    """
    length = len(body) if json_length is None else int(json_length[:20]) if json_length.isdecimal() else -1
    if not 0 <= length <= len(body):
        raise _malformed(f"{JSON_LENGTH} is {json_length:.50}, of a body of {len(body)} bytes")
    if length > LARGEST_JSON:
        raise _malformed(f"its JSON has {length} bytes, and at most {LARGEST_JSON} are read")
    try:
        said = json.loads(body[:length])
        described = [(str(t["name"]), t["datatype"], t["shape"], t["parameters"]["binary_data_size"])
                     for t in said[kind]]  # fmt: skip
    except (ValueError, TypeError, KeyError, RecursionError):
        raise _malformed(
            f"its first {length} bytes are no JSON with {kind} of which each has name, datatype, shape and "
            "parameters.binary_data_size"
        ) from None
    if len(described) > MOST_TENSORS:
        raise _malformed(f"it has {len(described)} {kind}, and at most {MOST_TENSORS} are read")
    if not all(_NAME.fullmatch(name) for name, *_ in described):
        raise _malformed("names of tensors have 1 to 64 letters, digits, dots, - and _")
    tensors: dict[str, Tensor] = {}
    for name, datatype, shape, size in described:
        tensors[name] = _tensor(name, datatype, shape, size, memoryview(body)[length:])
        length += size
    if length != len(body):
        raise _malformed(f"it has {len(body) - length} bytes more than its tensors")
    return said, tensors


def _tensor(name: str, datatype: Any, shape: Any, size: Any, rest: memoryview) -> Tensor:
    kind = _TYPES.get(datatype) if isinstance(datatype, str) else None
    if kind is None:
        raise _malformed(f"{name} is {datatype!r:.50}; understood are {', '.join(_TYPES)}")
    if not isinstance(shape, list) or len(shape) > MOST_DIMENSIONS or not all(map(_is_side, shape)):
        raise _malformed(f"the shape of {name} is {shape!r:.100}")
    wanted = prod(shape) * np.dtype(kind).itemsize
    if type(size) is not int or size != wanted or size > len(rest):
        raise _malformed(
            f"{name} of shape {shape} has {wanted} bytes; said are {size!r:.50}, and {len(rest)} are there"
        )
    # A copy: the bytes may begin anywhere, and arithmetic wants them at multiples of four.
    tensor: Tensor = np.frombuffer(rest[:size], kind).reshape(shape).copy()
    return tensor


def _is_side(side: object) -> bool:
    return type(side) is int and 0 < side < LONGEST_SIDE


def _malformed(what: str) -> BadBody:
    return BadBody("malformed-body", f"the body is no inference message with binary tensors: {what}")
