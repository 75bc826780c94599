"""Searching: which views of a map are like an image, by the map's own recipe."""

from collections.abc import Callable
from datetime import datetime

import numpy as np

from schemas.description import Description
from schemas.errors import Unavailable
from schemas.image import Image
from schemas.recipe import DescriptionRecipe
from schemas.records import Filters, MapLevels, MapRecord, Selection
from worker.description.describer import Describer
from worker.description.describers import Describers
from worker.description.scheduler import Scheduler, Timed
from worker.method import cascade
from worker.method.byte_vectors import Product
from worker.method.calibration import Calibration
from worker.method.cascade import ViewGone
from worker.search.catalogue import Catalogue
from worker.search.fetcher import Fetcher
from worker.search.ports import DescriptionReader
from worker.service.ports import Comparisons, Listings, Maps, Pending, Views
from worker.service.results import MapResults, RankedResults, ScoredView
from worker.service.stopwatch import Stopwatch

ROUNDS = 5
"""Attempts at a search; one is repeated when a view that it found is deleted before it ends."""


class RecipeChanged(Exception):
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
        listings: Listings,
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
        self._levels: dict[str, tuple[tuple[datetime, int], MapLevels]] = {}

    def describer(self, map_name: str) -> Describer:
        """The describer of a map's recipe; raises NotFound."""
        return self._describers.of(self._maps.get(map_name).description)

    def describe(self, image: Image, describer: Describer) -> Timed[Description]:
        """Describe an image ahead of all waiting enrolments; raises NothingStatic, Busy."""
        return self._scheduler.submit(image, describer.describe, urgent=True, parallel=describer.keypoints).result()

    def describe_and_search(
        self,
        image: Image,
        map_name: str,
        describer: Describer,
        described: dict[str, Timed[Description]],
        *,
        filters: Filters,
        top: int,
        candidates: int | None,
    ) -> MapResults:
        """Describe by the map's recipe and search; repeated when the map's recipe changes in between.

        `described` has the image's descriptions by recipe; one that is missing is made and added.
        """
        while True:
            recipe = describer.recipe
            if recipe.id not in described:
                described[recipe.id] = self.describe(image, describer)
            description = described[recipe.id].value
            try:
                results = self.search(map_name, recipe, description, filters=filters, top=top, candidates=candidates)
                return MapResults(map_name, description, results)
            except RecipeChanged:
                describer = self.describer(map_name)

    def search(
        self,
        map_name: str,
        recipe: DescriptionRecipe,
        description: Description,
        *,
        filters: Filters,
        top: int,
        candidates: int | None = None,
        observe: cascade.Observe = lambda stage, evidence: None,
    ) -> RankedResults:
        """The `top` best views of a map for a description by `recipe`; `observe` is called after each stage.

        Raises
        ------
        NotFound
            There is no such map.
        RecipeChanged
            The map's recipe is no longer `recipe`.
        Unavailable
            Views that were found were deleted before they could be ranked, `ROUNDS` times.
        """
        gone: frozenset[int] = frozenset()
        rounds = 0
        while rounds < ROUNDS:
            watch = Stopwatch(observe)
            # Counted first: a view described between the two reads is found and counted, never neither.
            pending = self._queue.count_pending(map_name)
            index, record = self._catalogue.index(map_name)
            if record.description.id != recipe.id:
                raise RecipeChanged
            config = record.ranking
            searched = config.searched if candidates is None else candidates
            selection = without(self._listings.select(map_name, filters), gone)
            found = index.search(description.vectors, max(top, searched), selection)
            try:
                ranked = cascade.rank(
                    description,
                    found,
                    recipe,
                    config,
                    Fetcher(self._descriptions, self._comparisons, recipe.id),
                    top=top,
                    reranked=candidates,
                    product=self._product,
                    observe=watch.observe,
                )
                shown = [*ranked.first, *([] if ranked.opposed is None else [ranked.opposed])]
                views = self._views.at(sorted({candidate.seq for candidate in shown}))
                described = {seq: view.description for seq, view in views.items() if view.description is not None}
                facts = [described[candidate.seq] for candidate in shown if candidate.seq in described]
                if len(facts) < len(shown):
                    raise ViewGone({candidate.seq for candidate in shown} - described.keys())
            except ViewGone as error:
                # A round that found damaged descriptions to leave out does not count: a map may have many.
                rounds += not self._comparisons.known(sorted(error.seqs - gone), recipe.id)
                gone |= error.seqs
                continue
            if any(of.recipe != recipe.id for of in facts):
                raise RecipeChanged  # while candidates were compared: views are shown by the map's present recipe
            scored = [ScoredView(**vars(candidate), view=views[candidate.seq]) for candidate in shown]
            return RankedResults(
                views=tuple(scored[: len(ranked.first)]),
                ranking=ranked,
                rival=None if ranked.opposed is None else scored[-1],
                levels=self._levels_of(record),
                pending=pending,
                revision=found.revision,
                recipe=record.recipe,
                calibration=self._calibration(record),
                searched=found.searched,
                timing_ms=watch.timing_ms(),
                keep_queries=record.keep_queries,
            )
        raise Unavailable("the map is being emptied faster than it can be searched; query again", 1)

    def _levels_of(self, record: MapRecord) -> MapLevels:
        """What wrong answers get in a map; read once for each revision."""
        kept = self._levels.get(record.name)
        if kept is None or kept[0] != (record.created_at, record.revision):
            levels = self._comparisons.levels(record.name)
            kept = (record.created_at, levels.revision), levels
            self._levels[record.name] = kept
        return kept[1]


def without(selection: Selection, gone: frozenset[int]) -> Selection:
    """A selection without views that were deleted meanwhile, or are damaged."""
    if not gone:
        return selection
    return Selection(selection.only, np.union1d(selection.never, np.array(sorted(gone), np.int64)))
