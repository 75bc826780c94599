"""The impostors that ship: descriptions of pictures that show no place of any map, one file for an encoder."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from safetensors import safe_open
from safetensors.numpy import save

from schemas.description import Floats
from schemas.recipe import DescriptionRecipe
from worker.description.vocabularies import SHIPPED, Vocabulary, shipped
from worker.method import dense_cells
from worker.method.byte_vectors import quantise
from worker.method.impostors import Impostors

PRESET = "default"
"""The preset by whose vocabulary they are described."""

EXTENT = (1.0, 0.75)
"""Extent of the pictures that `training.commands.describe_impostors` draws, or cuts out of photographs."""


def path_of(encoder: str) -> Path:
    """The file with the impostors of an encoder."""
    return SHIPPED / f"{encoder}.impostors.safetensors"


def write(path: Path, recipe: DescriptionRecipe, impostors: Impostors) -> None:
    """Write impostors, as described by a recipe, to a file."""
    tensors: dict[str, npt.NDArray[np.generic]] = {"cells": impostors.full}
    tensors |= {f"vectors.{name}": vectors for name, vectors in impostors.vectors.items()}
    metadata = {"recipe": json.dumps(_described_by(recipe)), "placeless": str(impostors.placeless)}
    path.write_bytes(save(tensors, metadata))


def shipped_for(recipe: DescriptionRecipe, vocabulary_of: Callable[[str], Vocabulary]) -> Impostors | None:
    """The impostors that ship for a recipe; None where there are none for its encoder or its grid of cells.

    Where the recipe has another vocabulary than they were described by, they have no histograms, and their cells are
    carried over to it.

    Parameters
    ----------
    recipe : DescriptionRecipe
    vocabulary_of : function
        From the digest that the recipe has to its vocabulary.
    """
    if recipe.parameters.dense is None or (kept := read(recipe.encoder)) is None:
        return None
    described_by, impostors = kept
    wanted = _described_by(recipe)
    if described_by == wanted:
        return impostors
    before = shipped(recipe.encoder, PRESET)
    if before is None or _grid(described_by) != _grid(wanted):
        return None
    return _carried_over(impostors, before, vocabulary_of(recipe.vocabulary), recipe.parameters.cell_channels())


@cache
def read(encoder: str) -> tuple[Mapping[str, object], Impostors] | None:
    """The impostors of an encoder, and before them what they were described by; None without a file."""
    path = path_of(encoder)
    if not path.exists():
        return None
    with safe_open(path, "numpy") as file:
        metadata = file.metadata()
        named = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    vectors = {name.removeprefix("vectors."): values for name, values in named.items() if name.startswith("vectors.")}
    return json.loads(metadata["recipe"]), Impostors(vectors, named["cells"], EXTENT, int(metadata["placeless"]))


def _described_by(recipe: DescriptionRecipe) -> dict[str, object]:
    """The fields of a recipe that cells and histograms depend on, in a picture in which nothing moves."""
    parameters = recipe.parameters.model_dump(mode="json", include={"channels", "dense"})
    return {"weights": recipe.weights, "vocabulary": recipe.vocabulary, **parameters}


def _grid(described_by: Mapping[str, object]) -> dict[str, object]:
    """The fields of `_described_by` that cells depend on before a vocabulary reduces their dimensions."""
    channels = described_by["channels"]
    assert isinstance(channels, Mapping)
    layers = {name: channel["layer"] for name, channel in channels.items()}
    return {"weights": described_by["weights"], "dense": described_by["dense"], "layers": layers}


def _carried_over(
    impostors: Impostors, before: Vocabulary, now: Vocabulary, shares: Mapping[str, float]
) -> Impostors | None:
    """Impostors with cells as another vocabulary would reduce them, nearly: the cosine is .96 and more.

    None where either vocabulary does not reduce cells.
    """
    reduced: dict[str, Floats] = {}
    end = 0
    for name in sorted(shares):
        old, new = before.channels[name].cells, now.channels[name].cells
        if old is None or new is None:
            return None
        begin, end = end, end + old.shape[1]
        whole = impostors.full[..., begin:end].astype(np.float32) @ old.T  # its columns are orthonormal
        reduced[name] = dense_cells.reduce(whole, new)
    return replace(impostors, vectors={}, full=quantise(dense_cells.join(reduced, shares)))
