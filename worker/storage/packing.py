"""Descriptions as bytes: concatenated arrays, read without a copy."""

from functools import cache
from math import prod
from struct import Struct
from typing import Any

import numpy as np
import numpy.typing as npt

from schemas.description import Appearance, ContextGraph, Description, Floats, Int8s, LocalFeatures
from schemas.recipe import DescriptionRecipe

FLOAT, SHORT, BYTE = np.dtype("<f4"), np.dtype("<i2"), np.dtype("i1")

Layout = tuple[tuple[np.dtype[Any], int], ...]
"""Type and number of dimensions of each array; wide types first, so that every array is aligned."""

APPEARANCE: Layout = ((FLOAT, 2), (FLOAT, 2), (FLOAT, 1), (SHORT, 1), (BYTE, 3))
"""Positions, embeddings, shares and labels of the graph's nodes; cells at half size."""

CELLS: Layout = ((BYTE, 3),)

KEYPOINTS: Layout = ((FLOAT, 2), (BYTE, 2))
"""Positions, descriptors."""


def pack_floats(values: Floats) -> bytes:
    """Float32, little-endian, as bytes."""
    return np.ascontiguousarray(values, FLOAT).tobytes()


def unpack_floats(body: bytes | bytearray) -> Floats:
    """Inverse of `pack_floats`, without a copy."""
    return np.frombuffer(body, FLOAT)


def pack_vectors(description: Description, recipe: DescriptionRecipe) -> bytes:
    """The histogram vectors of a description, concatenated in the order of the recipe's channels.

    Raises
    ------
    ValueError
        The description does not have the recipe's channels.
    """
    channels = recipe.parameters.channels
    if set(channels) != set(description.vectors):
        raise ValueError(f"the recipe has the channels {list(channels)}, not {list(description.vectors)}")
    return b"".join(pack_floats(description.vectors[name]) for name in channels)


def unpack_vectors(body: bytes, recipe: DescriptionRecipe) -> dict[str, Floats]:
    """The histogram vectors by channel, float32 (dimensions,) each."""
    channels = recipe.parameters.channels
    ends = np.cumsum([channel.length for channel in channels.values()])
    return dict(zip(channels, np.split(unpack_floats(body), ends[:-1]), strict=True))


def pack_appearance(appearance: Appearance) -> bytes:
    """Cells at half size and graph."""
    graph = appearance.graph
    return _pack(APPEARANCE, graph.positions, graph.embeddings, graph.shares, graph.labels, appearance.coarse)


def unpack_appearance(body: bytes, extent: tuple[float, float]) -> Appearance:
    """Inverse of `pack_appearance`; `extent` is that of the view's image."""
    positions, embeddings, shares, labels, coarse = _unpack(APPEARANCE, body)
    return Appearance(coarse, ContextGraph(labels, positions, embeddings, shares), extent)


def pack_cells(cells: Int8s) -> bytes:
    """Cells at full resolution."""
    return _pack(CELLS, cells)


def unpack_cells(body: bytes) -> Int8s:
    """Inverse of `pack_cells`."""
    [cells] = _unpack(CELLS, body)
    return cells


def pack_keypoints(features: LocalFeatures) -> bytes:
    """Local features."""
    return _pack(KEYPOINTS, features.positions, features.descriptors)


def unpack_keypoints(body: bytes) -> LocalFeatures:
    """Inverse of `pack_keypoints`."""
    positions, descriptors = _unpack(KEYPOINTS, body)
    return LocalFeatures(positions, descriptors)


def _pack(layout: Layout, *arrays: npt.NDArray[Any]) -> bytes:
    """The shapes of all arrays as uint32, little-endian, then the arrays."""
    for (dtype, dimensions), array in zip(layout, arrays, strict=True):
        if array.ndim != dimensions or not np.can_cast(array.dtype, dtype, "equiv"):
            raise ValueError(f"{dimensions} dimensions of {dtype} are kept here, not {array.shape} of {array.dtype}")
    shapes = _header(layout).pack(*(size for array in arrays for size in array.shape))
    bodies = [np.ascontiguousarray(a, dtype).tobytes() for (dtype, _), a in zip(layout, arrays, strict=True)]
    return b"".join([shapes, *bodies])


def _unpack(layout: Layout, body: bytes) -> list[npt.NDArray[Any]]:
    """Inverse of `_pack`; the arrays are views of `body`. Raises ValueError for bytes that `_pack` does not make."""
    header = _header(layout)
    if len(body) < header.size:
        raise ValueError(f"{len(body)} bytes are too few for the shapes of the arrays")
    sizes = header.unpack_from(body)
    offset, first = header.size, 0
    arrays = []
    for dtype, dimensions in layout:
        shape = sizes[first : first + dimensions]
        if offset + prod(shape) * dtype.itemsize > len(body):
            raise ValueError(f"an array of the shape {shape} is longer than what is left")
        arrays.append(np.ndarray(shape, dtype, body, offset))
        offset += prod(shape) * dtype.itemsize
        first += dimensions
    if offset != len(body):
        raise ValueError(f"the arrays take {offset} bytes, not {len(body)}")
    return arrays


@cache
def _header(layout: Layout) -> Struct:
    """Format of the shapes of all arrays."""
    return Struct(f"<{sum(dimensions for _, dimensions in layout)}I")
