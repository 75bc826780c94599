"""The impostors that ship: descriptions of pictures that show no place, one file for an encoder."""

import json
from collections.abc import Callable, Mapping
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
"""By whose vocabulary they are described."""

EXTENT = (1.0, 0.75)
"""Of the pictures that `training.commands.describe_impostors` draws."""


def path_of(encoder: str) -> Path:
    """Where those of an encoder are."""
    return SHIPPED / f"{encoder}.impostors.safetensors"


def write(path: Path, recipe: DescriptionRecipe, impostors: Impostors) -> None:
    """Keep impostors that were described by a recipe."""
    tensors: dict[str, npt.NDArray[np.generic]] = {"cells": impostors.full}
    tensors |= {f"vectors.{name}": vectors for name, vectors in impostors.vectors.items()}
    path.write_bytes(save(tensors, {"recipe": json.dumps(_described_by(recipe))}))


def shipped_for(recipe: DescriptionRecipe, vocabulary_of: Callable[[str], Vocabulary]) -> Impostors | None:
    """Those that ship for a recipe; None where there are none for its encoder or its grid of cells.

    For another vocabulary than theirs they have no histograms, and their cells are carried over to it.

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
    """What the impostors of an encoder were described by, and the impostors."""
    path = path_of(encoder)
    if not path.exists():
        return None
    with safe_open(path, "numpy") as file:
        described_by = json.loads(file.metadata()["recipe"])
        named = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    vectors = {name.removeprefix("vectors."): values for name, values in named.items() if name.startswith("vectors.")}
    return described_by, Impostors(vectors, named["cells"], EXTENT)


def _described_by(recipe: DescriptionRecipe) -> dict[str, object]:
    """What cells and histograms of a picture without anything that moves depend on."""
    parameters = recipe.parameters.model_dump(mode="json", include={"channels", "dense"})
    return {"weights": recipe.weights, "vocabulary": recipe.vocabulary, **parameters}


def _grid(described_by: Mapping[str, object]) -> dict[str, object]:
    """The part of `_described_by` that decides about cells before a vocabulary reduces them."""
    channels = described_by["channels"]
    assert isinstance(channels, Mapping)
    layers = {name: channel["layer"] for name, channel in channels.items()}
    return {"weights": described_by["weights"], "dense": described_by["dense"], "layers": layers}


def _carried_over(
    impostors: Impostors, before: Vocabulary, now: Vocabulary, shares: Mapping[str, float]
) -> Impostors | None:
    """As described by another vocabulary: what both keep of a cell is nearly all of it (cosine .96 and more).

    None where one of both has nothing that reduces cells.
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
    return Impostors({}, quantise(dense_cells.join(reduced, shares)), impostors.extent)
