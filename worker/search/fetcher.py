"""Reads candidates' descriptions from the store for `worker.method.cascade`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

from schemas.comparisons import KnownView
from schemas.description import Appearance, Int8s, LocalFeatures
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
    of_map : function, optional
        Sequence number to which of several maps; None where one map is searched.
    """

    def __init__(
        self,
        descriptions: DescriptionReader,
        comparisons: ComparisonReader,
        recipe: str,
        of_map: Callable[[int], int] | None = None,
    ) -> None:
        self._descriptions, self._comparisons, self._recipe = descriptions, comparisons, recipe
        self._of_map = of_map

    def appearances(self, seqs: Sequence[int]) -> list[Appearance]:
        """Cells at half size, graphs and extents."""
        return _in_order(self._descriptions.appearances(seqs, self._recipe), seqs)

    def cells(self, seqs: Sequence[int]) -> list[Int8s]:
        """Cells at full resolution."""
        return _in_order(self._descriptions.cells(seqs, self._recipe), seqs)

    def local_features(self, seqs: Sequence[int]) -> list[LocalFeatures]:
        """Local features."""
        return _in_order(self._descriptions.local_features(seqs, self._recipe), seqs)

    def known(self, seqs: Sequence[int]) -> list[KnownView]:
        """Names, positions and the map's own comparisons."""
        known = _in_order(self._comparisons.known(seqs, self._recipe), seqs)
        if self._of_map is None:
            return known
        return [replace(one, map=self._of_map(seq)) for one, seq in zip(known, seqs, strict=True)]


def _in_order(found: Mapping[int, T], seqs: Sequence[int]) -> list[T]:
    if len(found) < len(seqs):
        raise ViewGone(set(seqs) - found.keys())
    return [found[seq] for seq in seqs]
