"""Query a map: which of its views show the place of an image, with what confidence."""

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
from uuid6 import uuid7

from schemas.description import Description
from schemas.errors import RevisitError, Unavailable
from schemas.image import Image
from schemas.recipe import DescriptionRecipe
from schemas.records import Filters, MapLevels, MapRecord, Selection
from worker.description.describer import Describer, components
from worker.description.describers import Describers
from worker.description.scheduler import Scheduler, Timed
from worker.method import cascade
from worker.method.byte_vectors import Product
from worker.method.calibration import Calibration
from worker.method.cascade import ViewGone
from worker.method.cell_evidence import Region, contrast
from worker.method.decision import GROUPED, Decision, blame_image, decide
from worker.search.catalogue import Catalogue
from worker.search.fetcher import Fetcher
from worker.search.ports import DescriptionReader
from worker.service.drives import DRIVEN, Driven, Drives
from worker.service.explanations import Explained, Explanations, headline
from worker.service.inbox import KeptQueries
from worker.service.ports import Comparisons, Listings, Maps, Pending, Views
from worker.service.results import RankedResults, ScoredView
from worker.service.sheets import cells_of
from worker.service.stopwatch import Stopwatch

log = logging.getLogger("revisit.service")
DRIVE_TIMEOUT_S = 60.0
"""Seconds of silence after which a drive begins anew."""

ROUNDS = 5
"""Attempts at a search; one is repeated when a view that it found is deleted before it ends."""


KEPT_SIZE = 1024
"""Longer side of the image that is kept of a query that matched nothing, pixels."""

MOSTLY_MOVES = 0.2
"""Share of static cells below which an image shows too little of its place."""


class RecipeChanged(Exception):
    """The map's recipe changed while the query was described: it must be described by the new one."""


@dataclass(frozen=True, eq=False)
class QueryResult:
    """The answer to a query.

    Parameters
    ----------
    id : str
        Of the query.
    image : Image
        The decoded query image.
    description : Description
    results : RankedResults
    top : int
        How many of its views were wanted.
    decision : Decision
    differs : tuple of Region
        Where the first match and its rival differ, if the query is explained.
    explained : bool
        Whether an explanation can be drawn.
    driven : Driven or None
        What the images of its drive say together.
    timing_ms : mapping of stage to milliseconds
    """

    id: str
    image: Image
    description: Description
    results: RankedResults
    top: int
    decision: Decision
    differs: tuple[Region, ...]
    explained: bool
    driven: Driven | None
    timing_ms: Mapping[str, float]


class QueryService:
    """The use-case `query`. The answer depends only on the image, the request and the map's revision.

    Parameters
    ----------
    maps, views, listings, descriptions, comparisons, queue
        Parts of the store.
    describers : Describers
    scheduler : Scheduler
    catalogue : Catalogue
    decode : function
        Bytes to Image; raises BadImage.
    shrink : function
        Image to a smaller one, which is kept for its explanation.
    look_for_problem : function
        What is wrong with an image, in words, or None.
    thumbnail : function
        Bytes and length of the longer side to a small JPEG.
    kept : KeptQueries
        Where queries that matched nothing are kept, if their map says so.
    calibration : function
        Map to the calibration of its confidences.
    explanations : Explanations
        Where the latest explained queries are kept.
    drives : Drives
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
        decode: Callable[[bytes], Image],
        shrink: Callable[[Image], Image],
        look_for_problem: Callable[[Image], str | None],
        thumbnail: Callable[[bytes, int], bytes],
        kept: KeptQueries,
        calibration: Callable[[MapRecord], Calibration],
        explanations: Explanations,
        drives: Drives,
        product: Product,
    ) -> None:
        self._maps, self._views, self._listings = maps, views, listings
        self._descriptions, self._comparisons, self._queue = descriptions, comparisons, queue
        self._describers, self._scheduler, self._catalogue = describers, scheduler, catalogue
        self._decode, self._shrink, self._look_for_problem = decode, shrink, look_for_problem
        self._levels: dict[str, tuple[tuple[datetime, int], MapLevels]] = {}
        self._thumbnail, self._kept = thumbnail, kept
        self._calibration, self._explanations, self._product = calibration, explanations, product
        self._drives = drives

    def query(
        self,
        data: bytes,
        map_name: str,
        *,
        top: int = 5,
        candidates: int | None = None,
        filters: Filters | None = None,
        precision: float | None = None,
        explain: bool = False,
        drive: str | None = None,
        drive_timeout_s: float = DRIVE_TIMEOUT_S,
        keep: bool = True,
    ) -> QueryResult:
        """Which views of a map show the place of an image.

        Parameters
        ----------
        data : bytes
            The encoded image.
        map_name : str
        top : int
            Number of views returned at most.
        candidates : int, optional
            Candidates of each channel that are re-ranked; None takes the map's setting, 0 ranks by histograms alone.
        filters : Filters, optional
        precision : float, optional
            Share of matched answers that must be right, 0.5..0.999; None takes the map's setting.
        explain : bool
            Keep the query, so that its explanation can be drawn.
        drive : str, optional
            Name of the drive that the image is the next one of.
        drive_timeout_s : float
            The drive begins anew when its last image is older.
        keep : bool
            Whether the image may be kept among the map's unknown places.

        Raises
        ------
        BadImage, NotFound, NothingStatic, Busy, Unavailable
        """
        began = time.perf_counter()
        describer = self.describer(map_name)  # an unknown map is refused before any work is done
        image = self._decode(data)
        decoded = time.perf_counter()
        described, results = self._describe_and_search(
            image, map_name, describer, filters or Filters(), max(top, GROUPED if drive is None else DRIVEN), candidates
        )
        decision = decide(
            results.ranking,
            results.levels,
            results.calibration,
            precision or results.recipe.ranking.precision,
            searched=results.searched,
            shown=top,
            measured_alike=candidates != 0 or results.recipe.ranking.candidates == 0,
        )
        driven = None
        if drive is not None:
            results, decision, driven = self._drives.follow((map_name, drive), drive_timeout_s, results, decision)
        if decision.status != "matched":
            decision = blame_image(decision, self._problem(image, described.value))
        query_id = str(uuid7())
        whole = filters in (None, Filters()) and candidates != 0  # "not here" is said of the map, not of a part of it
        unknown = whole and decision.status == "no_match" and decision.reason.code != "poor-picture"
        if keep and results.keep_queries and unknown:
            self._keep_unknown(map_name, query_id, results.recipe.description, described.value, data)
        differs: tuple[Region, ...] = ()
        if explain:
            shown = replace(results, views=results.views[:top])
            explained = Explained(self._shrink(image), described.value, shown, headline(decision), results.rival)
            self._explanations.keep(query_id, explained)
            differs = self._differs(explained) if decision.reason.code == "look-alike" else ()
        return QueryResult(
            id=query_id,
            image=image,
            description=described.value,
            results=results,
            top=top,
            decision=decision,
            differs=differs,
            explained=explain,
            driven=driven,
            timing_ms={
                "decode": (decoded - began) * 1000,
                "queue": described.queue_ms,
                "encode": described.encode_ms,
                "describe": described.finish_ms,
                **results.timing_ms,
                "total": (time.perf_counter() - began) * 1000,
            },
        )

    def describer(self, map_name: str) -> Describer:
        """The describer of a map's recipe; raises NotFound."""
        return self._describers.of(self._maps.get(map_name).description)

    def describe(self, image: Image, describer: Describer) -> Timed[Description]:
        """Describe an image ahead of all waiting enrolments; raises NothingStatic, Busy."""
        return self._scheduler.submit(image, describer.describe, urgent=True, parallel=describer.keypoints).result()

    def _levels_of(self, record: MapRecord) -> MapLevels:
        """What wrong answers get in a map; read once for each revision."""
        kept = self._levels.get(record.name)
        if kept is None or kept[0] != (record.created_at, record.revision):
            levels = self._comparisons.levels(record.name)
            kept = (record.created_at, levels.revision), levels
            self._levels[record.name] = kept
        return kept[1]

    def _keep_unknown(
        self, map_name: str, query_id: str, recipe: DescriptionRecipe, description: Description, data: bytes
    ) -> None:
        """Keep a query that matched nothing; that it cannot be kept is logged, and its answer is given all the same."""
        try:
            small = self._thumbnail(data, KEPT_SIZE)
            self._kept.keep(map_name, query_id, recipe, description, small, datetime.now(UTC))
        except RevisitError as error:
            log.error("the query %s of map %s is not kept: %s", query_id, map_name, error.detail)

    def _problem(self, image: Image, description: Description) -> str | None:
        """What may keep the image from being recognised, in words; None when nothing is seen."""
        if description.static_share < MOSTLY_MOVES:
            return f"{1 - description.static_share:.0%} of the image shows things that move"
        return self._look_for_problem(image)

    def _differs(self, explained: Explained) -> tuple[Region, ...]:
        """Where the first match and its rival differ; nothing when there is no rival or its cells are gone."""
        if explained.rival is None:
            return ()
        two = explained.results.views[0], explained.rival
        stored = self._descriptions.cells([one.seq for one in two], explained.results.recipe.description.id)
        ours, theirs = (cells_of(explained, one, stored.get(one.seq)) for one in two)
        if ours is None or theirs is None:
            return ()
        return tuple(contrast(ours, theirs, explained.description.appearance.extent, components).regions)

    def _describe_and_search(
        self, image: Image, map_name: str, describer: Describer, filters: Filters, top: int, candidates: int | None
    ) -> tuple[Timed[Description], RankedResults]:
        """Describe by the map's recipe and search; repeated when the map's recipe changes in between."""
        while True:
            described = self.describe(image, describer)
            try:
                return described, self.search(
                    map_name, describer.recipe, described.value, filters=filters, top=top, candidates=candidates
                )
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


def without(selection: Selection, gone: frozenset[int]) -> Selection:
    """A selection without views that were deleted meanwhile, or are damaged."""
    if not gone:
        return selection
    return Selection(selection.only, np.union1d(selection.never, np.array(sorted(gone), np.int64)))
