"""What a search needs from outside: an index, and the changes and descriptions that a store keeps."""

from collections.abc import Mapping, Sequence
from typing import Protocol

from schemas.description import Appearance, Floats, Int8s, LocalFeatures
from schemas.records import Candidates, Changes, MapRecord, Selection


class Index(Protocol):
    """Nearest histograms of one map, per channel. A cache of the store: losing it loses nothing."""

    @property
    def revision(self) -> int:
        """The map's revision it has caught up to."""
        ...

    @property
    def recipe(self) -> str:
        """Id of the recipe whose vectors it holds."""
        ...

    def __len__(self) -> int: ...

    def apply(self, changes: Changes) -> None:
        """Catch up."""
        ...

    def search(self, vectors: Mapping[str, Floats], count: int, selection: Selection) -> Candidates:
        """The `count` nearest views of the selection by each channel, joined.

        Parameters
        ----------
        vectors : mapping of channel to float32 of shape (dimensions,)
        count : int
            Of each channel.
        """
        ...


class MapReader(Protocol):
    """Maps by name."""

    def get(self, name: str) -> MapRecord:
        """One map; raises NotFound."""
        ...

    def revision(self, name: str) -> int:
        """The map's revision; raises NotFound."""
        ...


class DescriptionReader(Protocol):
    """Descriptions, in the parts that an index and a ranking read. What was deleted meanwhile is absent."""

    def since(self, name: str, revision: int) -> Changes:
        """All that an index at `revision` needs to be up to date (0: everything)."""
        ...

    def appearances(self, seqs: Sequence[int], recipe: str) -> dict[int, Appearance]:
        """Cells at half size, graphs and extents."""
        ...

    def cells(self, seqs: Sequence[int], recipe: str) -> dict[int, Int8s]:
        """Cells in full, (rows, columns, dimensions)."""
        ...

    def local_features(self, seqs: Sequence[int], recipe: str) -> dict[int, LocalFeatures]:
        """Local features."""
        ...
