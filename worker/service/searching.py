"""Searching: which views of a map are like an image, by the map's own recipe."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import takewhile

import numpy as np

from schemas.description import Description
from schemas.errors import Unavailable
from schemas.image import Image
from schemas.recipe import DescriptionRecipe
from schemas.records import Candidates, Filters, MapRecord, Selection
from worker.description.describer import Describer
from worker.description.describers import Describers
from worker.description.scheduler import Scheduler, Timed
from worker.method import cascade
from worker.method.byte_vectors import Product
from worker.method.calibration import Calibration
from worker.method.cascade import ViewGone
from worker.method.joining import pooled
from worker.search.fetcher import Fetcher
from worker.search.merging import merged
from worker.search.ports import Catalogue, DescriptionReader, Selecting
from worker.service.caller import Caller
from worker.service.known_levels import KnownLevels
from worker.service.ports import Comparisons, Maps, Pending, Views
from worker.service.results import RankedResults, ScoredView, SearchedMap, SearchOutcome
from worker.service.stopwatch import Stopwatch

ROUNDS = 5
"""Attempts at a search; one is repeated when a view that it found is deleted before it ends."""


class DescribedByAnother(Exception):
    """The map's recipe changed while the query was described: it must be described by the new one."""


class Searcher:
    """Describes images and ranks the views of maps for them.

    Parameters
    ----------
    maps, views, listings, descriptions, comparisons, queue
        Parts of the store.
    describers : Describers
    scheduler : Scheduler
    catalogue : Catalogue
    calibration : function
        Map to the calibration of its confidences.
    product : Product
        Multiplies dense cells; the choice affects speed, not results.
    """

    def __init__(
        self,
        *,
        maps: Maps,
        views: Views,
        listings: Selecting,
        descriptions: DescriptionReader,
        comparisons: Comparisons,
        queue: Pending,
        describers: Describers,
        scheduler: Scheduler,
        catalogue: Catalogue,
        calibration: Callable[[MapRecord], Calibration],
        product: Product,
    ) -> None:
        self._maps, self._views, self._listings = maps, views, listings
        self._descriptions, self._comparisons, self._queue = descriptions, comparisons, queue
        self._describers, self._scheduler, self._catalogue = describers, scheduler, catalogue
        self._calibration, self._product = calibration, product
        self._levels = KnownLevels(comparisons)

    def describer(self, map_name: str) -> Describer:
        """The describer of a map's recipe; raises NotFound."""
        return self._describers.of(self._maps.get(map_name).description)

    def describe(self, image: Image, describer: Describer, caller: Caller | None = None) -> Timed[Description]:
        """Describe an image ahead of all waiting enrolments; raises NothingStatic, Busy, CallerGone."""
        caller = caller or Caller()
        caller.check()
        return caller.result(describer.submit(self._scheduler, image, urgent=True))

    def describe_and_search(
        self,
        image: Image,
        maps: Mapping[str, Filters],
        describers: Mapping[str, Describer],
        *,
        top: int,
        candidates: int | None,
        caller: Caller | None = None,
    ) -> tuple[list[SearchOutcome], list[Timed[Description]]]:
        """Describe an image by each recipe of some maps, and search; repeated when a recipe changes in between.

        Parameters
        ----------
        image : Image
        maps, top, candidates
            As for `search`; the maps may have different recipes.
        describers : mapping of str to Describer
            By the names of the maps, as `describer` gave them.
        caller : Caller, optional
            Whoever waits for it, and may leave; raises CallerGone.

        Returns
        -------
        found : list of SearchOutcome
            Of maps with one recipe, ranking and calibration, in the order of the first of them.
        described : list of Timed Description
            One for each recipe.
        """
        described: dict[str, Timed[Description]] = {}
        while True:
            try:
                found = []
                for together in self._alike(maps):
                    describer = describers[next(iter(together))]
                    recipe = describer.recipe
                    if recipe.id not in described:
                        described[recipe.id] = self.describe(image, describer, caller)
                    description = described[recipe.id].value
                    results = self.search(together, recipe, description, top=top, candidates=candidates)
                    found.append(SearchOutcome(description, results))
                return found, list(described.values())
            except DescribedByAnother:
                describers = {name: self.describer(name) for name in maps}

    def _alike(self, maps: Mapping[str, Filters]) -> list[Mapping[str, Filters]]:
        """Maps that can be searched as one: those whose scores and probabilities mean the same."""
        if len(maps) == 1:
            return [maps]
        groups: dict[tuple[str, str, str | None], dict[str, Filters]] = {}
        for name, filters in maps.items():
            groups.setdefault(_kind(self._maps.get(name)), {})[name] = filters
        return list(groups.values())

    def search(
        self,
        maps: Mapping[str, Filters],
        recipe: DescriptionRecipe,
        description: Description,
        *,
        top: int,
        candidates: int | None = None,
        observe: cascade.Observe = lambda stage, evidence: None,
    ) -> RankedResults:
        """The best views of maps with one recipe for a description by it.

        Parameters
        ----------
        maps : mapping of str to Filters
            By their names.
        recipe : DescriptionRecipe
        description : Description
        top : int
            Number of views returned at most.
        candidates : int, optional
            Candidates of each channel that are re-ranked; None takes the maps' setting, 0 ranks by histograms alone.
        observe : function
            Called after each stage.

        Raises
        ------
        NotFound
            There is no such map.
        DescribedByAnother
            A map's recipe is no longer `recipe` when the search begins, or the maps are no longer of one kind.
        Unavailable
            Views that were found, or the index itself, were gone before they could be ranked, `ROUNDS` times.
        """
        gone: frozenset[int] = frozenset()
        rounds = 0
        while rounds < ROUNDS:
            try:
                return self._search_without(gone, maps, recipe, description, top, candidates, Stopwatch(observe))
            except ViewGone as error:
                # A round that found damaged descriptions to leave out does not count: a map may have many.
                rounds += not self._comparisons.known(sorted(error.seqs - gone), recipe.id)
                gone |= error.seqs
        raise Unavailable("the map is being emptied faster than it can be searched; query again", 1)

    def _search_without(
        self,
        gone: frozenset[int],
        maps: Mapping[str, Filters],
        recipe: DescriptionRecipe,
        description: Description,
        top: int,
        candidates: int | None,
        watch: Stopwatch,
    ) -> RankedResults:
        """The results of one round; raises ViewGone where one of the views is no longer there, or damaged."""
        # Counted first: a view described between the two reads is found and counted, never neither.
        pending = [self._queue.count_pending(name) for name in maps]
        indexes = [self._catalogue.index(name) for name in maps]
        records = [record for _, record in indexes]
        if records[0].description.id != recipe.id or len({_kind(record) for record in records}) > 1:
            raise DescribedByAnother
        config = records[0].ranking
        # Not only as many as are wanted: what is found decides the order, and must not depend on that.
        count = max(top, cascade.LISTED, config.searched if candidates is None else candidates)
        several = [
            index.search(description.vectors, count, without(self._listings.select(name, filters), gone))
            for (index, _), (name, filters) in zip(indexes, maps.items(), strict=True)
        ]
        fixed = [self._catalogue.camera_fixed(index, recipe) for index, _ in indexes]
        fetcher = Fetcher(self._descriptions, self._comparisons, recipe.id, _map_of(several), fixed)
        query = fetcher.without_fixed(description)
        ranked = cascade.rank(
            query,
            merged(several, count),
            recipe,
            config,
            fetcher,
            top=top,
            reranked=candidates,
            product=self._product,
            impostors=self._describers.impostors(recipe),
            observe=watch.observe,
        )
        shown = [*ranked.first, *([] if ranked.rival is None else [ranked.candidate(ranked.rival)])]
        # By the recipe that was searched: the map may have changed over while candidates were compared.
        views = self._views.at(sorted({candidate.seq for candidate in shown}), recipe.id)
        described = {seq for seq, view in views.items() if view.description is not None}
        if missing := {candidate.seq for candidate in shown} - described:
            raise ViewGone(missing)
        scored = [ScoredView(**vars(candidate), view=views[candidate.seq]) for candidate in shown]
        return RankedResults(
            views=tuple(scored[: len(ranked.first)]),
            query=query,
            ranking=ranked,
            rival=None if ranked.rival is None else scored[-1],
            levels=pooled([self._levels.of(record) for record in records]),
            maps=tuple(
                SearchedMap(
                    record.name,
                    one.revision,
                    one.searched,
                    waiting,
                    record.keep_queries,
                    record.keep_matches,
                    record.number,
                )
                for record, one, waiting in zip(records, several, pending, strict=True)
            ),
            recipe=records[0].recipe,
            calibration=self._calibration(records[0]),
            timing_ms=watch.timing_ms(),
            fixed=tuple(one for one in fixed if one is not None),
        )

    def further(self, results: RankedResults, count: int) -> RankedResults:
        """Results with so many of their candidates as views; they end before one that is not there any more."""
        more = [results.ranking.candidate(index) for index in range(len(results.views), count)]
        views = self._views.at([candidate.seq for candidate in more], results.recipe.description.id)
        described = {seq for seq, view in views.items() if view.description is not None}
        there = takewhile(lambda one: one.seq in described, more)
        return replace(
            results, views=(*results.views, *(ScoredView(**vars(one), view=views[one.seq]) for one in there))
        )


def _kind(record: MapRecord) -> tuple[str, str, str | None]:
    """Maps in which this is the same are searched as one."""
    return record.description.id, record.ranking.id, record.calibration


def _map_of(several: Sequence[Candidates]) -> Callable[[int], int] | None:
    """Which of several maps a candidate is of."""
    if len(several) == 1:
        return None
    map_of = {int(seq): number for number, one in enumerate(several) for seq in one.seqs}
    return map_of.__getitem__


def without(selection: Selection, gone: frozenset[int]) -> Selection:
    """A selection without views that were deleted meanwhile, or are damaged."""
    if not gone:
        return selection
    return replace(selection, never=np.union1d(selection.never, np.array(sorted(gone), np.int64)))
