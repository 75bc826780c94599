"""Ports of the search: an index, and the store's maps, changes and descriptions."""

from collections.abc import Mapping, Sequence
from typing import Protocol

from schemas.comparisons import KnownView
from schemas.description import Appearance, Floats, Int8s, LocalFeatures
from schemas.recipe import DescriptionRecipe
from schemas.records import Candidates, Changes, Filters, MapRecord, Selection, VectorsFound
from worker.method.camera_fixed import CameraFixed

SAMPLE = 24
"""Views of a map that tell what is fixed to its camera."""


class SearchableIndex(Protocol):
    """Nearest histogram vectors of one map, per channel. A cache of the store."""

    @property
    def revision(self) -> int:
        """The map's revision that it contains."""
        ...

    @property
    def recipe(self) -> str:
        """Id of the description recipe of its vectors."""
        ...

    def search(self, vectors: Mapping[str, Floats], count: int, selection: Selection) -> Candidates:
        """The union of the `count` nearest views of the selection by each channel.

        Parameters
        ----------
        vectors : mapping of channel to float32 of shape (dimensions,)
        count : int
            Views per channel.
        selection : Selection
            With filters only where the index lies in the database.

        Raises
        ------
        ViewGone
            The index is no longer that of its map, which has to be taken from the catalogue again.
        """
        ...

    def sample(self) -> tuple[int, ...]:
        """Up to `SAMPLE` of its views, by sequence number, drawn from all: always the same ones of the same views."""
        ...


class Index(SearchableIndex, Protocol):
    """An index in memory."""

    def __len__(self) -> int: ...

    def apply(self, changes: Changes) -> None:
        """Bring the index to the revision of the changes."""
        ...


class Catalogue(Protocol):
    """The maps' indexes, brought up to date with the store before each search."""

    def index(self, name: str) -> tuple[SearchableIndex, MapRecord]:
        """The index of a map, with all changes committed before this call, and the map at that revision.

        Raises
        ------
        NotFound
            There is no such map.
        """
        ...

    def camera_fixed(self, index: SearchableIndex, recipe: DescriptionRecipe) -> CameraFixed | None:
        """What is fixed to the camera that took the views of an index, which are described by the recipe, or None."""
        ...

    def revisions(self) -> Mapping[str, int]:
        """The revision of each index that there is by map; waits for no search."""
        ...

    def recalls(self) -> Mapping[str, float]:
        """The measured recall of each map that is searched approximately, 0 to 1."""
        ...

    def prepare(self, name: str, recipe: DescriptionRecipe) -> None:
        """Read what a map has by a recipe that it is about to change to, so that no query has to.

        Raises
        ------
        NotFound
            There is no such map.
        """
        ...

    def forget(self, name: str) -> None:
        """Drop the indexes of a deleted map."""
        ...

    def close(self) -> None:
        """Wait for what reads in the background."""
        ...


class Selecting(Protocol):
    """Which views of a map a search may return."""

    def select(self, name: str, filters: Filters) -> Selection:
        """The views of a map that the filters select; raises NotFound."""
        ...


class VectorReader(Protocol):
    """Vectors that the database itself searches."""

    def look_up(self, name: str) -> tuple[MapRecord, int, int | None]:
        """A map, its number, and the revision up to which it can be searched; raises NotFound.

        None for the revision: `follow` has to be called first.
        """
        ...

    def follow(self, name: str) -> None:
        """Bring the searched vectors of a map up to its revision; raises NotFound."""
        ...

    def revisions(self) -> Mapping[str, int]:
        """The revision up to which each map is searched."""
        ...

    def recalls(self) -> Mapping[str, float]:
        """The measured recall of each map that HNSW searches."""
        ...

    def sample(self, map_id: int, recipe: str, count: int) -> list[int]:
        """Up to `count` views described by a recipe, by sequence number: the first in the order of `schemas.draw`."""
        ...

    def nearest(
        self,
        name: str,
        map_id: int,
        recipe: DescriptionRecipe,
        vectors: Mapping[str, Floats],
        count: int,
        selection: Selection,
        *,
        least: int,
        approximate: bool,
    ) -> VectorsFound | None:
        """The nearest views by each channel, as of one revision that is `least` or later.

        None when the name is that of another map by now, or the map has another recipe.
        """
        ...


class MapReader(Protocol):
    """Maps by name."""

    def numbers(self) -> set[int]:
        """The numbers of all maps that there are."""
        ...

    def get(self, name: str) -> MapRecord:
        """One map; raises NotFound."""
        ...

    def description(self, recipe: str) -> DescriptionRecipe:
        """A stored description recipe by its id; raises Damaged."""
        ...


class DescriptionReader(Protocol):
    """Descriptions, in the parts that an index and a ranking read. Deleted views are absent."""

    def since(self, name: str, revision: int, recipe: DescriptionRecipe | None = None) -> Changes:
        """Changes to a map's searchable views since a revision (0: all views); raises NotFound.

        `recipe`: of the views described by this one, whether or not the map is searched by it.
        """
        ...

    def count_described(self, name: str, recipe: str) -> int:
        """How many views of a map a recipe describes; raises NotFound."""
        ...

    def appearances(self, seqs: Sequence[int], recipe: str) -> dict[int, Appearance]:
        """Cells at half size, graphs and extents."""
        ...

    def cells(self, seqs: Sequence[int], recipe: str) -> dict[int, Int8s]:
        """Cells at full resolution, int8 of shape (rows, columns, dimensions)."""
        ...

    def local_features(self, seqs: Sequence[int], recipe: str) -> dict[int, LocalFeatures]:
        """Local features."""
        ...


class ComparisonReader(Protocol):
    """What is known of views besides their images. Deleted views are absent."""

    def known(self, seqs: Sequence[int], recipe: str) -> dict[int, KnownView]:
        """Name, position, and the map's own comparison by a recipe."""
        ...
