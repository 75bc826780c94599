"""Search inside the database: one index per map that holds no vectors, and the catalogue of them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import count

import numpy as np

from schemas.description import Floats
from schemas.latest import Latest
from schemas.recipe import DescriptionRecipe
from schemas.records import Candidates, Changes, Filters, MapRecord, Selection, VectorsFound
from worker.method.camera_fixed import CameraFixed
from worker.method.cascade import ViewGone
from worker.search.fixed_cells import MOST_KEPT, FixedCells
from worker.search.flat_index import FlatIndex
from worker.search.ports import SAMPLE, DescriptionReader, SearchableIndex, VectorReader

_NONE = np.zeros(0, np.int64)

ROUNDS = 10
"""Attempts to find a map and its vectors at the same revision."""


@dataclass(frozen=True)
class DatabaseIndex:
    """The index of a map at one revision; see `worker.search.ports.SearchableIndex`.

    The database finds the nearest views; a `FlatIndex` of those alone ranks them, so that distances and ties come out
    as they do in memory.

    Parameters
    ----------
    vectors : VectorReader
    name : str
        Of the map.
    map_id : int
    description : DescriptionRecipe
    revision : int
        Searches are of this revision of the map, or a later one.
    approximate : bool
    """

    vectors: VectorReader
    name: str
    map_id: int
    description: DescriptionRecipe
    revision: int
    approximate: bool

    @property
    def recipe(self) -> str:
        """Id of the description recipe of its vectors."""
        return self.description.id

    def search(self, vectors: Mapping[str, Floats], count: int, selection: Selection) -> Candidates:
        """The union of the `count` nearest views of the selection by each channel.

        Raises
        ------
        ViewGone
            The map was deleted or changed its recipe meanwhile: it has to be taken from the catalogue again.
        InvalidParameters
            The filters of the selection do not fit the map.
        """
        found = self.vectors.nearest(
            self.name,
            self.map_id,
            self.description,
            vectors,
            count,
            selection,
            least=self.revision,
            approximate=self.approximate,
        )
        if found is None:
            raise ViewGone
        return _ranked(found, self.description, vectors, count)

    def sample(self) -> tuple[int, ...]:
        """Some views drawn from all; see `worker.search.ports.SearchableIndex`."""
        return tuple(sorted(self.vectors.sample(self.map_id, self.recipe, SAMPLE)))


def _ranked(found: VectorsFound, recipe: DescriptionRecipe, vectors: Mapping[str, Floats], count: int) -> Candidates:
    """The views that the database found, ranked by an index in memory of these alone."""
    flat = FlatIndex.of(recipe)
    flat.apply(Changes(found.revision, recipe.id, found.seqs, found.vectors, _NONE))
    ranked = flat.search(vectors, count, Selection(None, _NONE))
    order = found.order[np.searchsorted(found.seqs, ranked.seqs)]
    return replace(ranked, revision=found.revision, searched=found.searched, order=order)


class DatabaseCatalogue:
    """The maps' indexes in the database, brought up to date before each search; nothing is kept in memory.

    Parameters
    ----------
    vectors : VectorReader
    descriptions : DescriptionReader
    approximate : bool
        Whether HNSW may be used, where it was built.
    """

    def __init__(self, vectors: VectorReader, descriptions: DescriptionReader, *, approximate: bool = False) -> None:
        self._vectors, self._approximate = vectors, approximate
        self._fixed = FixedCells(descriptions)
        self._samples: Latest[tuple[int, str, int], tuple[int, ...]] = Latest(MOST_KEPT)

    def index(self, name: str) -> tuple[DatabaseIndex, MapRecord]:
        """The index of a map, with all changes committed before this call, and the map at that revision.

        Raises
        ------
        NotFound
            There is no such map.
        """
        least: int | None = None
        for attempt in count():
            record, map_id, revision = self._vectors.look_up(name)
            least = record.revision if least is None else least
            # A map that others change all the time is searched with all changes before this call.
            if revision is not None and revision >= (record.revision if attempt < ROUNDS else least):
                recipe = record.description
                return DatabaseIndex(self._vectors, name, map_id, recipe, revision, self._approximate), record
            self._vectors.follow(name)
        raise AssertionError("unreachable")

    def camera_fixed(self, index: SearchableIndex, recipe: DescriptionRecipe) -> CameraFixed | None:
        """What is fixed to the camera that took the views of an index; its sample is read once for each revision."""
        if not isinstance(index, DatabaseIndex):  # one in memory, of a shadow
            return self._fixed.of(index.sample(), recipe)
        # With the number: a new map begins with the last revision that any map was given.
        key = index.map_id, index.recipe, index.revision
        return self._fixed.of(self._samples.get_or_make(key, index.sample), recipe)

    def revisions(self) -> Mapping[str, int]:
        """The revision of each map that was searched."""
        return self._vectors.revisions()

    def recalls(self) -> Mapping[str, float]:
        """The recall of each map that HNSW searches, against an exact search."""
        return self._vectors.recalls() if self._approximate else {}

    def prepare(self, name: str, recipe: DescriptionRecipe) -> None:
        """Nothing is read: vectors of another recipe are searched once the map has it."""

    def forget(self, name: str) -> None:
        """Nothing is held of a deleted map; its rows went with it."""

    def close(self) -> None:
        """Nothing reads in the background."""


class InsideSearch:
    """Leaves filters to the index, so that it applies them inside its search; see `worker.search.ports.Selecting`."""

    def select(self, name: str, filters: Filters) -> Selection:
        """The filters themselves."""
        return Selection(None, _NONE, None if filters == Filters() else filters)
