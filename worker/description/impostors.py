"""The impostors that ship: descriptions of pictures that show no place, one file for an encoder."""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from safetensors import safe_open
from safetensors.numpy import save

from schemas.recipe import DescriptionRecipe
from worker.description.vocabularies import SHIPPED
from worker.method.impostors import Impostors

EXTENT = (1.0, 0.75)
"""Of the pictures that `training.commands.describe_impostors` draws."""


def path_of(encoder: str) -> Path:
    """Where those of an encoder are."""
    return SHIPPED / f"{encoder}.impostors.safetensors"


def write(path: Path, recipe: DescriptionRecipe, impostors: Impostors) -> None:
    """Keep impostors that were described by a recipe."""
    tensors: dict[str, npt.NDArray[np.generic]] = {"cells": impostors.full}
    tensors |= {f"vectors.{name}": vectors for name, vectors in impostors.vectors.items()}
    path.write_bytes(save(tensors, {"recipe": json.dumps(_of_cells(recipe))}))


def shipped_for(recipe: DescriptionRecipe) -> Impostors | None:
    """Those that ship for a recipe; None where there are none for its encoder, vocabulary or cells."""
    if recipe.parameters.dense is None or (kept := read(recipe.encoder)) is None:
        return None
    of_cells, impostors = kept
    return impostors if of_cells == _of_cells(recipe) else None


@cache
def read(encoder: str) -> tuple[Mapping[str, object], Impostors] | None:
    """What those of an encoder were described by, and they themselves."""
    path = path_of(encoder)
    if not path.exists():
        return None
    with safe_open(path, "numpy") as file:
        of_cells = json.loads(file.metadata()["recipe"])
        named = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    vectors = {name.removeprefix("vectors."): values for name, values in named.items() if name.startswith("vectors.")}
    return of_cells, Impostors(vectors, named["cells"], EXTENT)


def _of_cells(recipe: DescriptionRecipe) -> Mapping[str, object]:
    """What cells and histograms of a picture without anything that moves depend on."""
    parameters = recipe.parameters.model_dump(mode="json", include={"channels", "dense"})
    return {"weights": recipe.weights, "vocabulary": recipe.vocabulary, **parameters}
