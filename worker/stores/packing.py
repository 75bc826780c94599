"""Descriptions as bytes: float32 vectors side by side, safetensors for what has several tensors."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from safetensors import numpy as safetensors

from schemas.description import Appearance, ContextGraph, Description, Floats, LocalFeatures
from schemas.recipe import Recipe

LITTLE = np.dtype("<f4")
CELLS = "cells."


def pack_floats(values: Floats) -> bytes:
    """Bytes of float32, little-endian."""
    return np.ascontiguousarray(values, LITTLE).tobytes()


def unpack_floats(body: bytes | bytearray) -> Floats:
    """The float32 of `pack_floats`, without a copy."""
    return np.frombuffer(body, LITTLE)


def pack_vectors(description: Description, recipe: Recipe) -> bytes:
    """The vectors of a description side by side, in the order of the recipe's channels.

    Raises
    ------
    ValueError
        The description does not have the recipe's channels.
    """
    channels = recipe.parameters.channels
    if set(channels) != set(description.vectors):
        raise ValueError(f"the recipe has the channels {list(channels)}, not {list(description.vectors)}")
    return b"".join(pack_floats(description.vectors[name]) for name in channels)


def pack_appearance(appearance: Appearance) -> bytes:
    """Cells and graph as safetensors."""
    graph = appearance.graph
    tensors: dict[str, npt.NDArray[np.generic]] = {
        CELLS + name: np.ascontiguousarray(cells) for name, cells in appearance.cells.items()
    }
    tensors["labels"] = np.ascontiguousarray(graph.labels)
    tensors["positions"] = np.ascontiguousarray(graph.positions)
    tensors["embeddings"] = np.ascontiguousarray(graph.embeddings)
    tensors["shares"] = np.ascontiguousarray(graph.shares)
    return _save(tensors)


def unpack_appearance(body: bytes) -> Appearance:
    """The appearance of `pack_appearance`."""
    tensors = safetensors.load(body)
    # safetensors writes its tensors in an order of its own; the names put the channels into theirs.
    cells = {name.removeprefix(CELLS): tensors[name] for name in sorted(tensors) if name.startswith(CELLS)}
    graph = ContextGraph(tensors["labels"], tensors["positions"], tensors["embeddings"], tensors["shares"])
    return Appearance(cells, graph)


def pack_keypoints(features: LocalFeatures) -> bytes:
    """Keypoints as safetensors."""
    return _save(
        {
            "positions": np.ascontiguousarray(features.positions),
            "descriptors": np.ascontiguousarray(features.descriptors),
        }
    )


def unpack_keypoints(body: bytes) -> LocalFeatures:
    """The keypoints of `pack_keypoints`."""
    tensors = safetensors.load(body)
    return LocalFeatures(tensors["positions"], tensors["descriptors"])


def _save(tensors: Mapping[str, npt.NDArray[np.generic]]) -> bytes:
    return bytes(safetensors.save(dict(tensors)))
