"""Reads candidates' descriptions from the store for `worker.method.cascade`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

from schemas.comparisons import KnownView
from schemas.description import Appearance, Description, Int8s, LocalFeatures
from worker.method.camera_fixed import CameraFixed, without_fixed
from worker.method.cascade import ViewGone
from worker.search.ports import ComparisonReader, DescriptionReader

T = TypeVar("T")


class Fetcher:
    """Descriptions by one recipe, in the order of the candidates; raises ViewGone when one was deleted.

    Implements `worker.method.cascade.Fetch`.

    Parameters
    ----------
    descriptions : DescriptionReader
    comparisons : ComparisonReader
    recipe : str
        Id of the description recipe.
    map_of : function, optional
        From a sequence number to the number of its map among several; None where one map is searched.
    fixed : sequence of CameraFixed or None
        What is fixed to the cameras that took the views: cells that show it are zero.
    """

    def __init__(
        self,
        descriptions: DescriptionReader,
        comparisons: ComparisonReader,
        recipe: str,
        map_of: Callable[[int], int] | None = None,
        fixed: Sequence[CameraFixed | None] = (),
    ) -> None:
        self._fixed = [one for one in fixed if one is not None]
        self._descriptions, self._comparisons, self._recipe = descriptions, comparisons, recipe
        self._map_of = map_of

    def without_fixed(self, query: Description) -> Description:
        """The query without what is fixed to these cameras; candidates come without it too."""
        return without_fixed(query, self._fixed)

    def appearances(self, seqs: Sequence[int]) -> list[Appearance]:
        """Cells at half size, graphs and extents."""
        found = _in_order(self._descriptions.appearances(seqs, self._recipe), seqs)
        return [replace(one, coarse=self._cleared(one.coarse)) for one in found] if self._fixed else found

    def cells(self, seqs: Sequence[int]) -> list[Int8s]:
        """Cells at full resolution."""
        return [self._cleared(one) for one in _in_order(self._descriptions.cells(seqs, self._recipe), seqs)]

    def _cleared(self, cells: Int8s) -> Int8s:
        for one in self._fixed:
            cells = one.cleared(cells)
        return cells

    def local_features(self, seqs: Sequence[int]) -> list[LocalFeatures]:
        """Local features."""
        return _in_order(self._descriptions.local_features(seqs, self._recipe), seqs)

    def known(self, seqs: Sequence[int]) -> list[KnownView]:
        """Names, positions and the map's own comparisons."""
        known = _in_order(self._comparisons.known(seqs, self._recipe), seqs)
        if self._map_of is None:
            return known
        return [replace(one, map=self._map_of(seq)) for one, seq in zip(known, seqs, strict=True)]


def _in_order(found: Mapping[int, T], seqs: Sequence[int]) -> list[T]:
    if len(found) < len(seqs):
        raise ViewGone(set(seqs) - found.keys())
    return [found[seq] for seq in seqs]
