"""Ports of the search: an index, and the store's maps, changes and descriptions."""

from collections.abc import Mapping, Sequence
from typing import Protocol

from schemas.comparisons import KnownView
from schemas.description import Appearance, Floats, Int8s, LocalFeatures
from schemas.records import Candidates, Changes, MapRecord, Selection


class Index(Protocol):
    """Nearest histogram vectors of one map, per channel. A cache of the store."""

    @property
    def revision(self) -> int:
        """The map's revision that it contains."""
        ...

    @property
    def recipe(self) -> str:
        """Id of the description recipe of its vectors."""
        ...

    def __len__(self) -> int: ...

    def apply(self, changes: Changes) -> None:
        """Bring the index to the revision of the changes."""
        ...

    def search(self, vectors: Mapping[str, Floats], count: int, selection: Selection) -> Candidates:
        """The union of the `count` nearest views of the selection by each channel.

        Parameters
        ----------
        vectors : mapping of channel to float32 of shape (dimensions,)
        count : int
            Views per channel.
        selection : Selection
        """
        ...


class MapReader(Protocol):
    """Maps by name."""

    def get(self, name: str) -> MapRecord:
        """One map; raises NotFound."""
        ...


class DescriptionReader(Protocol):
    """Descriptions, in the parts that an index and a ranking read. Deleted views are absent."""

    def since(self, name: str, revision: int) -> Changes:
        """Changes to a map's searchable views since a revision (0: all views); raises NotFound."""
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
