"""Compare the views of a map with one another, in the background, to learn what wrong answers get there."""

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import count
from typing import Protocol

import numpy as np
import numpy.typing as npt

from schemas.comparisons import Comparison
from schemas.description import Description, Floats
from schemas.errors import NotFound
from schemas.health import Uncompared
from schemas.recipe import DescriptionRecipe, MapRecipe, RankingConfig
from schemas.records import Candidates, Selection
from worker.method import cascade
from worker.method.byte_vectors import Product
from worker.method.cascade import ViewGone
from worker.method.evidence import Ranking
from worker.method.places import ENOUGH_VIEWS, SAME_SPOT_INLIERS, SAME_SPOT_SCORE, Places
from worker.search.fetcher import Fetcher
from worker.search.ports import Catalogue, ComparisonReader, DescriptionReader, SearchableIndex
from worker.service.giving_way import GivingWay, Rest
from worker.service.trouble import STORAGE_ERRORS

log = logging.getLogger("revisit.worker")

SAMPLE = 2000
"""Views of a map that are compared at most: means over so many views are exact enough for a map of any size."""

FIRST = 32
"""Views of a map that are compared while images wait to be described: enough for the means to settle."""

PORTION = 8
"""Views compared at a time, whose comparisons are stored together."""

WIDENED = 3
"""A search whose candidates show the view's own place is repeated without these views: this often for the usual number
of candidates, from then on for twice as many each time."""

MOST_OWN = 4000
"""Views of its own place, found so, beyond which a view is not compared: reading them takes long."""

GIVE_WAY_S = 2.0
"""Seconds that the comparison of a view gives way to queries in all."""


class ComparisonStore(ComparisonReader, Protocol):
    """Comparisons of views."""

    def last_revision(self) -> int:
        """The last revision given to any map."""
        ...

    def uncompared(self, sample: int, count: int, *, busy: bool = False) -> Uncompared | None:
        """Up to `count` views, of one map, that should be compared, or None; `busy`: only what cannot wait."""
        ...

    def keep(
        self, name: str, by: MapRecipe, comparisons: list[Comparison], now: datetime, as_of: int | None = None
    ) -> None:
        """Store comparisons, unless the map no longer scores by this recipe and ranking, or attributes of its views
        were changed since its revision `as_of`."""
        ...


class Descriptions(DescriptionReader, Protocol):
    """Descriptions, in parts and whole."""

    def vectors(self, seqs: Sequence[int], recipe: str) -> dict[int, Floats]:
        """Histogram vectors."""
        ...

    def whole(self, seq: int, recipe: DescriptionRecipe) -> Description | None:
        """A view's whole description; None when it was deleted."""
        ...


@dataclass(frozen=True)
class _Among:
    """What views are compared with: the `count` of an index, by a recipe; `give_way` is called before each stage."""

    index: SearchableIndex
    recipe: MapRecipe
    count: int
    give_way: Callable[[], None] = lambda: None


class MapComparer:
    """Queries each map with its own views. Nothing is encoded: descriptions are read from the store.

    Parameters
    ----------
    comparisons, descriptions
        Parts of the store.
    catalogue : Catalogue
    product : Product
        Multiplies dense cells.
    quiet_s : function
        Seconds since the last query was answered, 0 while one is under way: comparisons give way to queries.
    """

    def __init__(
        self,
        *,
        comparisons: ComparisonStore,
        descriptions: Descriptions,
        catalogue: Catalogue,
        product: Product,
        quiet_s: Callable[[], float] = lambda: math.inf,
    ) -> None:
        self._comparisons, self._descriptions = comparisons, descriptions
        self._catalogue, self._product = catalogue, product
        self._quiet_s = quiet_s
        self._nothing_due: tuple[int, int] | None = None  # sample and revision at which nothing was due

    def step(self, *, busy: bool = False, rest: Rest = lambda seconds: False) -> bool:
        """Compare a portion of views; returns whether there was anything to do.

        Parameters
        ----------
        busy : bool
            Images wait to be described: compare no more than `FIRST` of each map, and small maps not again.
        rest : Rest
            Called while queries are answered, with 0 after each view, and after the portion with the time that it
            took. A job that waits ends all three.
        """
        sample, revision = FIRST if busy else SAMPLE, self._comparisons.last_revision()
        if (sample, revision) == self._nothing_due:
            return False
        due = self._comparisons.uncompared(sample, PORTION, busy=busy)
        if due is None:
            self._nothing_due = sample, revision
            return False
        try:
            index, record = self._catalogue.index(due.map)
        except NotFound:
            return True  # the map has just been deleted
        if record.description.id != due.recipe:
            return True  # the map has just changed over
        began, waited_s, made = time.monotonic(), 0.0, []
        for seq in due.seqs:
            give_way = GivingWay(self._quiet_s, rest, GIVE_WAY_S)
            made.append(self._attempt(seq, _Among(index, record.recipe, due.among, give_way)))
            waited_s += give_way.waited_s
            if rest(0):
                break
        kept = [one for one in made if one is not None]
        self._comparisons.keep(due.map, record.recipe, kept, datetime.now(UTC), record.revision)
        rest(max(0.0, time.monotonic() - began - 2 * waited_s))  # waiting was rest too
        return True

    def all(self) -> None:
        """Compare everything that is due, without a rest."""
        while self.step():
            pass

    def compare(self, seqs: Sequence[int], index: SearchableIndex, recipe: MapRecipe, among: int) -> list[Comparison]:
        """Comparisons of some views by a recipe with an index of its own; nothing is stored.

        `among`: how many views the index has. Views that were deleted meanwhile are left out.
        """
        made = [self._attempt(seq, _Among(index, recipe, among)) for seq in seqs]
        return [one for one in made if one is not None]

    def _attempt(self, seq: int, among: _Among) -> Comparison | None:
        """As `_compare`; a view that cannot be compared is logged, and left until the map changes.

        Raises
        ------
        DiskFull, StorageFailed
            It cannot be read now, which says nothing of the view.
        """
        try:
            return self._compare(seq, among)
        except STORAGE_ERRORS:
            raise
        except NotFound:  # the map has just been deleted
            return None
        except Exception:
            log.exception("the view with the sequence number %d could not be compared with its map", seq)
            return Comparison(seq, level=None, gap=None, same_spot=(), among=among.count, others=0)

    def _compare(self, seq: int, among: _Among) -> Comparison | None:
        """The comparison of one view; None when views were deleted meanwhile."""
        among.give_way()
        recipe, config = among.recipe.description, among.recipe.ranking
        whole = self._descriptions.whole(seq, recipe)
        if whole is None:
            return None
        fixed = [self._catalogue.camera_fixed(among.index, recipe)]
        fetcher = Fetcher(self._descriptions, self._comparisons, recipe.id, fixed=fixed)
        query = fetcher.without_fixed(whole)
        try:
            usual = max(2, config.searched)
            found = _search(among, query, usual, {seq})
            ranking = self._rank(query, found, among, fetcher)
            spot = {int(s) for s in ranking.seqs[_same_spot(ranking)]}
            same_spot = tuple(sorted(spot))
            near = own = {seq} | spot
            places = _places(seq, found, fetcher, config)
            scored = zip(ranking.seqs, ranking.scores, strict=True)
            best = max((float(score) for other, score in scored if places.same(seq, int(other))), default=None)
            for repeated in count():
                seqs = [int(other) for other in found.seqs]
                own = own | {other for other in seqs if places.same(seq, other)}
                near = near | {other for other in seqs if not places.apart(seq, other)}
                left_out = near if among.count - len(near) >= ENOUGH_VIEWS else own
                if left_out.isdisjoint(seqs):
                    break
                if len(left_out) > MOST_OWN:
                    return Comparison(
                        seq, level=None, gap=None, same_spot=same_spot, among=among.count, others=0, own=best
                    )
                found = _search(among, query, usual << max(0, repeated + 1 - WIDENED), left_out)
                places = _places(seq, found, fetcher, config)
            if repeated > WIDENED:
                found = _search(among, query, usual, left_out)
            others = self._rank(query, found, among, fetcher)
        except ViewGone:
            return None
        level = float(others.scores[0]) if len(others.seqs) else None
        rival = others.rival
        gap = None if level is None or rival is None else level - float(others.scores[rival])
        breadth = None if gap is None else others.breadth(others.rivals)
        return Comparison(
            seq,
            level=level,
            gap=gap,
            same_spot=same_spot,
            among=among.count,
            others=found.searched,
            rival=None if level is None else int(others.seqs[0]),
            own=best,
            breadth=breadth,
        )

    def _rank(self, query: Description, found: Candidates, among: _Among, fetcher: Fetcher) -> Ranking:
        return cascade.rank(
            query, found, among.recipe.description, among.recipe.ranking, fetcher, top=2,
            observe=lambda stage, evidence: among.give_way(), product=self._product,
        )  # fmt: skip


def _search(among: _Among, query: Description, count: int, never: set[int]) -> Candidates:
    among.give_way()
    return among.index.search(query.vectors, count, Selection(None, np.array(sorted(never))))


def _places(seq: int, found: Candidates, fetcher: Fetcher, config: RankingConfig) -> Places:
    """Places of a view and of its candidates."""
    seqs = [seq, *(int(other) for other in found.seqs)]
    return Places(dict(zip(seqs, fetcher.known(seqs), strict=True)), config.same_place_m)


def _same_spot(ranking: Ranking) -> npt.NDArray[np.intp]:
    """Which candidates show the spot of the query itself."""
    return np.flatnonzero((ranking.inliers >= SAME_SPOT_INLIERS) & (ranking.scores >= SAME_SPOT_SCORE))
