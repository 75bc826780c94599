"""Query maps: which of their views show the place of an image, with what confidence."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import chain

from uuid6 import uuid7

from schemas.description import Booleans, Description
from schemas.errors import InvalidParameters, NotFound, RevisitError
from schemas.image import Image
from schemas.inbox import QueryToKeep
from schemas.records import Filters
from worker.description.describer import components
from worker.description.scheduler import Timed
from worker.images.framing import framed
from worker.method.camera_fixed import left_out
from worker.method.cell_evidence import Region, contrast
from worker.method.decision import GROUPED, Decision, blame_image, decide, of_nothing
from worker.method.joining import Joined, join
from worker.search.ports import DescriptionReader
from worker.service import moving
from worker.service.caller import Caller
from worker.service.day_scores import ScoreKeeper
from worker.service.drives import Driven, Drives
from worker.service.explanations import Explained, Explanations, headline
from worker.service.keeping import QueryKeeper
from worker.service.ports import Views
from worker.service.query_options import QueryOptions
from worker.service.results import RankedResults, ScoredView, SearchOutcome
from worker.service.searching import Searcher
from worker.service.sheets import cells_of
from worker.service.waiting_room import WaitingRoom

log = logging.getLogger("revisit.service")

KEPT_SIZE = 1024
"""Longer side of the image of a query that is kept, pixels."""

UNLIKE = 0.7
"""Score of a match below which the image may add to what its map has: see `worker.service.proposals`."""


@dataclass(frozen=True, eq=False)
class QueryResult:
    """The answer to a query.

    Parameters
    ----------
    id : str
        Of the query.
    image : Image
        The decoded query image.
    seen : Image
        As it was compared: by its zoom and roll, `worker.images.framing.framed`.
    names : tuple of str
        Of the maps, as they were given.
    found : tuple of SearchOutcome
        Of all maps, those that were searched as one together; the one with the first place is `leading`.
    joined : Joined
        What they say together.
    decision : Decision
        The verdict, the reason for it, and the probabilities of the leading maps' places.
    top : int
        How many views were wanted.
    differs : tuple of Region
        Where the first match and its rival differ, if the query is explained.
    explained : bool
    drawable : bool
        Whether explanations of the leading maps' views can be drawn: it is explained, and such queries are kept.
    driven : Driven or None
        What the images of its drive say together.
    timing_ms : mapping of stage to milliseconds
    """

    id: str
    image: Image
    seen: Image
    names: tuple[str, ...]
    found: tuple[SearchOutcome, ...]
    joined: Joined
    decision: Decision
    top: int
    differs: tuple[Region, ...]
    explained: bool
    drawable: bool
    driven: Driven | None
    timing_ms: Mapping[str, float]

    @property
    def leading(self) -> SearchOutcome:
        """The maps, searched as one, that have the first place."""
        return self.found[self.joined.leading]

    @property
    def results(self) -> RankedResults:
        """What was found in the leading maps."""
        return self.leading.results

    @property
    def description(self) -> Description:
        """The description of the query image by the recipe of the leading maps."""
        return self.leading.description

    @property
    def rival(self) -> tuple[ScoredView, RankedResults] | None:
        """The best view of another place than the first, and the results that have it."""
        if self.joined.rival is not None:
            results = self.found[self.joined.rival].results
            return results.views[0], results
        return None if self.results.rival is None else (self.results.rival, self.results)


class QueryService:
    """The use-case `query`. The answer depends only on the image, the request and the maps' revisions.

    Parameters
    ----------
    searcher : Searcher
    views, descriptions
        Parts of the store.
    room : WaitingRoom
        Where queries wait before their images are decoded.
    shrink : function
        Image to a smaller one, which is kept for its explanation.
    look_for_problem : function
        What is wrong with an image, in words, or None.
    is_blank : function
        Whether an image shows nothing at all beside cells that are fixed to the camera: two of them are alike wherever
        they were taken.
    thumbnail : function
        Bytes and length of the longer side to a small JPEG.
    kept : QueryKeeper
        Where queries are kept that matched nothing, or a view that they look unlike, if their map says so.
    scores : ScoreKeeper
        Where scores of sure matches are kept, if their map keeps matches.
    explanations : Explanations
        Where the latest explained queries are kept.
    drives : Drives
    """

    def __init__(
        self,
        *,
        searcher: Searcher,
        views: Views,
        descriptions: DescriptionReader,
        room: WaitingRoom,
        shrink: Callable[[Image], Image],
        look_for_problem: Callable[[Image], str | None],
        is_blank: Callable[[Image, Booleans], bool],
        thumbnail: Callable[[bytes, int], bytes],
        kept: QueryKeeper,
        scores: ScoreKeeper,
        explanations: Explanations,
        drives: Drives,
    ) -> None:
        self._searcher, self._views, self._descriptions = searcher, views, descriptions
        self._room, self._shrink, self._look_for_problem = room, shrink, look_for_problem
        self._is_blank = is_blank
        self._thumbnail, self._kept, self.scores = thumbnail, kept, scores
        self._explanations, self._drives = explanations, drives

    @property
    def outside(self) -> int:
        """Queries that wait before their images are decoded."""
        return self._room.outside

    def query(
        self, data: bytes, *maps: str, options: QueryOptions = QueryOptions(), caller: Caller | None = None
    ) -> QueryResult:
        """Which views of some maps show the place of an image.

        Parameters
        ----------
        data : bytes
            The encoded image.
        maps : str
            Names of one map or more.
        options : QueryOptions
        caller : Caller, optional
            Whoever waits for the answer. Where they leave before the turn of the image comes, no drive counts it and
            nothing is kept of it; from then on the query is finished without them.

        Raises
        ------
        BadImage, NotFound, NothingStatic, InvalidParameters, Busy, Unavailable, CallerGone
        """
        if options.drive is not None and len(maps) > 1:
            raise InvalidParameters.of("drive", "goes with one map")
        caller = caller or Caller()
        caller.check()
        began = time.perf_counter()
        # Unknown maps and views are refused before any work is done.
        describers = {name: self._searcher.describer(name) for name in maps}
        wanted = self._filters(options.filters, maps)
        with self._room.decoded(data, caller) as decoded:
            image, seen = decoded.image, framed(decoded.image, options.zoom, options.roll)
            found, described = self._searcher.describe_and_search(
                seen, wanted, describers, top=max(options.top, GROUPED), candidates=options.candidates, caller=caller
            )
        result = self._decided(image, seen, maps, found, options)
        if options.keep and options.of_whole_maps and seen is image:
            self._keep(result, data)
        if options.explain:
            result = replace(result, differs=self._explain(result))
        timing_ms = {"decode": decoded.decode_ms, **_timing_ms(described, result.found)}
        timing_ms["queue"] += decoded.waited_ms
        return replace(result, timing_ms={**timing_ms, "total": (time.perf_counter() - began) * 1000})

    def _decided(
        self, image: Image, seen: Image, maps: tuple[str, ...], found: Sequence[SearchOutcome], options: QueryOptions
    ) -> QueryResult:
        """The answer to a query, from what was found in the maps; a drive, if it is of one, counts the image."""
        decisions = [_decide(one.results, options) for one in found]
        blank = [self._is_blank(seen, left_out(one.description, one.results.query)) for one in found]
        decisions = [of_nothing(one) if nothing else one for one, nothing in zip(decisions, blank, strict=True)]
        driven = None
        if options.drive is not None:
            [one], [decision] = found, decisions
            results, decision, driven = self._drives.follow(
                (maps[0], options.drive),
                options.drive_timeout_s,
                one.results,
                decision,
                options.consistent,
                options.call,
                blank[0],
            )
            found, decisions = [replace(one, results=results)], [decision]
        joined = join(decisions)
        leading, decision = found[joined.leading], joined.decision
        if decision.status != "matched":
            decision = blame_image(decision, self._problem(image, leading))
        return QueryResult(
            id=str(uuid7()),
            image=image,
            seen=seen,
            names=maps,
            found=tuple(found),
            joined=joined,
            decision=decision,
            top=options.top,
            differs=(),
            explained=options.explain,
            drawable=options.explain and self._explanations.most > 0,
            driven=driven,
            timing_ms={},
        )

    def _filters(self, filters: Filters, maps: Sequence[str]) -> dict[str, Filters]:
        """The filters of each map, with those views to exclude that are its own; raises InvalidParameters."""
        if len(maps) == 1 or not filters.exclude:
            return dict.fromkeys(maps, filters)  # of one map the search itself refuses unknown views
        own: dict[str, list[str]] = {name: [] for name in maps}
        unknown = []
        for view_id in filters.exclude:
            try:
                own[self._views.get(view_id).map].append(view_id)
            except (NotFound, KeyError):
                unknown.append(view_id)
        if unknown:
            raise InvalidParameters.of("exclude", f"no map of these has the views {', '.join(unknown)}")
        return {name: replace(filters, exclude=tuple(ids)) for name, ids in own.items()}

    def _keep(self, result: QueryResult, data: bytes) -> None:
        """Keep a query that matched nothing, or a view that it looks unlike, in each map that keeps such queries.

        That it cannot be kept is logged, and its answer is given all the same.
        """
        status = result.decision.status
        if status == "no_match" and result.decision.reason.code != "poor-picture":
            maps = [(one.name, of) for of in result.found for one in of.results.maps if one.keep_queries]
            self._keep_in(maps, result.id, data, None)
        elif status == "matched" and result.results.first_map.keep_matches:
            best = result.results.views[0]
            self.scores.note(best.view.map, result.results.recipe, best.seq, best.score, datetime.now(UTC))
            # A poor photo refreshes no place.
            if best.score < UNLIKE and self._problem(result.image, result.leading) is None:
                self._keep_in([(best.view.map, result.leading)], result.id, data, (best.seq, best.score))

    def _keep_in(
        self,
        maps: Sequence[tuple[str, SearchOutcome]],
        query_id: str,
        data: bytes,
        match: tuple[int, float] | None,
    ) -> None:
        """Keep a query in maps, in each as it is described for it; `match` as `QueryToKeep` has it."""
        small = b""
        for number, (name, of) in enumerate(maps):
            kept_id = str(uuid7()) if number else query_id
            recipe = of.results.recipe.description
            try:
                small = small or self._thumbnail(data, KEPT_SIZE)
                query = QueryToKeep(kept_id, recipe, of.description, small, datetime.now(UTC), match)
                self._kept.keep(name, query)
            except RevisitError as error:
                log.error("the query %s is not kept in the map %s: %s", query_id, name, error.detail)

    def _explain(self, result: QueryResult) -> tuple[Region, ...]:
        """Keep the query, so that it can be drawn; returns where the first match and its rival differ."""
        rival = None if result.rival is None else result.rival[0]
        small, results = self._shrink(result.seen), result.results
        explained = Explained.of(
            small, results.query, results, headline(result.decision), rival, result.names, result.top
        )
        if result.seen is not result.image:
            explained = replace(explained, photo=self._shrink(result.image))
        self._explanations.keep(result.id, explained)
        return self._differs(explained) if result.decision.reason.code == "look-alike" else ()

    def _problem(self, image: Image, of: SearchOutcome) -> str | None:
        """What may keep the image from being recognised, in words; None when nothing is seen."""
        described, recipe = of.description, of.results.recipe.description
        moves = moving.problem_of(described.label_shares, described.static_share, recipe)
        return moves or self._look_for_problem(image)

    def _differs(self, explained: Explained) -> tuple[Region, ...]:
        """Where the first match and its rival differ; nothing when there is no rival or its cells are gone."""
        if explained.rival is None:
            return ()
        two = explained.views[0], explained.rival
        stored = self._descriptions.cells([one.seq for one in two], explained.recipe.description.id)
        ours, theirs = (cells_of(explained, one, stored.get(one.seq)) for one in two)
        if ours is None or theirs is None:
            return ()
        return tuple(contrast(ours, theirs, explained.description.appearance.extent, components).regions)


def _decide(results: RankedResults, options: QueryOptions) -> Decision:
    """The verdict on what one search found, by its map's precision and candidates where the query names none."""
    ranking = results.recipe.ranking
    return decide(
        results.ranking,
        results.levels,
        results.calibration,
        options.precision or ranking.precision,
        searched=results.searched,
        shown=options.top,
        measured_alike=options.candidates != 0 or ranking.candidates == 0,
    )


def _timing_ms(described: Sequence[Timed[Description]], found: Sequence[SearchOutcome]) -> dict[str, float]:
    """Milliseconds of each stage of describing and searching, over all recipes and maps."""
    searches = [one.results.timing_ms for one in found]
    stages = dict.fromkeys(chain.from_iterable(searches))
    return {
        "queue": sum(one.queue_ms for one in described),
        "encode": sum(one.encode_ms for one in described),
        "describe": sum(one.finish_ms for one in described),
        **{stage: sum(one.get(stage, 0.0) for one in searches) for stage in stages},
    }
