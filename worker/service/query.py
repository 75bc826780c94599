"""Query maps: which of their views show the place of an image, with what confidence."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import chain

from uuid6 import uuid7

from schemas.description import Description
from schemas.errors import InvalidParameters, NotFound, RevisitError
from schemas.image import Image
from schemas.records import Filters
from worker.description.describer import components
from worker.description.scheduler import Timed
from worker.method.cell_evidence import Region, contrast
from worker.method.decision import GROUPED, Decision, blame_image, decide
from worker.method.joining import Joined, join
from worker.search.ports import DescriptionReader
from worker.service.drives import DRIVEN, Driven, Drives
from worker.service.explanations import Explained, Explanations, headline
from worker.service.inbox import KeptQueries
from worker.service.ports import Views
from worker.service.results import MapResults, RankedResults, ScoredView
from worker.service.searching import Searcher
from worker.service.sheets import cells_of

log = logging.getLogger("revisit.service")
DRIVE_TIMEOUT_S = 60.0
"""Seconds of silence after which a drive begins anew."""

KEPT_SIZE = 1024
"""Longer side of the image that is kept of a query that matched nothing, pixels."""

MOSTLY_MOVES = 0.2
"""Share of static cells below which an image shows too little of its place."""


@dataclass(frozen=True, eq=False)
class QueryResult:
    """The answer to a query.

    Parameters
    ----------
    id : str
        Of the query.
    image : Image
        The decoded query image.
    maps : tuple of MapResults
        Of each map that was searched, as asked for; the one with the first place is `leading`.
    alone : tuple of Decision
        What each map says by itself.
    joined : Joined
        What they say together.
    decision : Decision
        The verdict, the reason for it, and the probabilities of the leading map's places.
    rival : ScoredView or None
        Best view of another place than the first; of the map `rival_map`.
    top : int
        How many views were wanted.
    differs : tuple of Region
        Where the first match and its rival differ, if the query is explained.
    explained : bool
        Whether explanations of the leading map's views can be drawn.
    driven : Driven or None
        What the images of its drive say together.
    timing_ms : mapping of stage to milliseconds
    """

    id: str
    image: Image
    maps: tuple[MapResults, ...]
    alone: tuple[Decision, ...]
    joined: Joined
    decision: Decision
    rival: ScoredView | None
    top: int
    differs: tuple[Region, ...]
    explained: bool
    driven: Driven | None
    timing_ms: Mapping[str, float]

    @property
    def leading(self) -> MapResults:
        """The map with the first place."""
        return self.maps[self.joined.leading]

    @property
    def rival_map(self) -> MapResults:
        """The map of the rival."""
        return self.leading if self.joined.rival is None else self.maps[self.joined.rival]

    @property
    def results(self) -> RankedResults:
        """Those of the leading map."""
        return self.leading.results

    @property
    def description(self) -> Description:
        """Of the query image, by the leading map's recipe."""
        return self.leading.description


class QueryService:
    """The use-case `query`. The answer depends only on the image, the request and the maps' revisions.

    Parameters
    ----------
    searcher : Searcher
    views, descriptions
        Parts of the store.
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
        decode: Callable[[bytes], Image],
        shrink: Callable[[Image], Image],
        look_for_problem: Callable[[Image], str | None],
        thumbnail: Callable[[bytes, int], bytes],
        kept: KeptQueries,
        explanations: Explanations,
        drives: Drives,
    ) -> None:
        self._searcher, self._views, self._descriptions = searcher, views, descriptions
        self._decode, self._shrink, self._look_for_problem = decode, shrink, look_for_problem
        self._thumbnail, self._kept = thumbnail, kept
        self._explanations, self._drives = explanations, drives

    def query(
        self,
        data: bytes,
        *maps: str,
        top: int = 5,
        candidates: int | None = None,
        filters: Filters | None = None,
        precision: float | None = None,
        explain: bool = False,
        drive: str | None = None,
        drive_timeout_s: float = DRIVE_TIMEOUT_S,
        keep: bool = True,
    ) -> QueryResult:
        """Which views of some maps show the place of an image.

        Parameters
        ----------
        data : bytes
            The encoded image.
        maps : str
            Names of one map or more.
        top : int
            Number of views returned at most.
        candidates : int, optional
            Candidates of each channel that are re-ranked; None takes the map's setting, 0 ranks by histograms alone.
        filters : Filters, optional
            Applied to each map.
        precision : float, optional
            Share of matched answers that must be right, 0.5..0.999; None takes the map's setting.
        explain : bool
            Keep the query, so that its explanation can be drawn.
        drive : str, optional
            Name of the drive that the image is the next one of; only with one map.
        drive_timeout_s : float
            The drive begins anew when its last image is older.
        keep : bool
            Whether the image may be kept among the maps' unknown places.

        Raises
        ------
        BadImage, NotFound, NothingStatic, InvalidParameters, Busy, Unavailable
        """
        if drive is not None and len(maps) > 1:
            raise InvalidParameters.of("drive", "goes with one map")
        began = time.perf_counter()
        # Unknown maps and views are refused before any work is done.
        describers = {name: self._searcher.describer(name) for name in maps}
        parts = self._filters(filters or Filters(), maps)
        image = self._decode(data)
        decoded = time.perf_counter()
        described: dict[str, Timed[Description]] = {}
        found = [
            self._searcher.describe_and_search(
                image,
                name,
                describer,
                described,
                filters=part,
                top=max(top, GROUPED if drive is None else DRIVEN),
                candidates=candidates,
            )
            for (name, describer), part in zip(describers.items(), parts, strict=True)
        ]
        alone = [self._decide(one.results, top, candidates, precision) for one in found]
        driven = None
        if drive is not None:
            [one], [decision] = found, alone
            results, decision, driven = self._drives.follow((one.name, drive), drive_timeout_s, one.results, decision)
            found, alone = [replace(one, results=results)], [decision]
        joined = join(alone)
        leading, decision = found[joined.leading], joined.decision
        rival = leading.results.rival if joined.rival is None else found[joined.rival].results.views[0]
        if decision.status != "matched":
            decision = blame_image(decision, self._problem(image, leading.description))
        query_id = str(uuid7())
        whole = filters in (None, Filters()) and candidates != 0  # "not here" is said of the map, not of a part of it
        if keep and whole and decision.status == "no_match" and decision.reason.code != "poor-picture":
            for one in found:
                self._keep_unknown(query_id if one is leading else str(uuid7()), one, data)
        differs: tuple[Region, ...] = ()
        if explain:
            shown = replace(leading.results, views=leading.results.views[:top])
            explained = Explained(self._shrink(image), leading.description, shown, headline(decision), rival)
            self._explanations.keep(query_id, explained)
            differs = self._differs(explained) if decision.reason.code == "look-alike" else ()
        return QueryResult(
            id=query_id,
            image=image,
            maps=tuple(found),
            alone=tuple(alone),
            joined=joined,
            decision=decision,
            rival=rival,
            top=top,
            differs=differs,
            explained=explain,
            driven=driven,
            timing_ms={
                "decode": (decoded - began) * 1000,
                "queue": sum(one.queue_ms for one in described.values()),
                "encode": sum(one.encode_ms for one in described.values()),
                "describe": sum(one.finish_ms for one in described.values()),
                **_sums([one.results.timing_ms for one in found]),
                "total": (time.perf_counter() - began) * 1000,
            },
        )

    @staticmethod
    def _decide(results: RankedResults, top: int, candidates: int | None, precision: float | None) -> Decision:
        ranking = results.recipe.ranking
        return decide(
            results.ranking,
            results.levels,
            results.calibration,
            precision or ranking.precision,
            searched=results.searched,
            shown=top,
            measured_alike=candidates != 0 or ranking.candidates == 0,
        )

    def _filters(self, filters: Filters, maps: Sequence[str]) -> list[Filters]:
        """The filters of each map, with those views to exclude that are its own; raises InvalidParameters."""
        if len(maps) == 1 or not filters.exclude:
            return [filters] * len(maps)  # of one map the search itself refuses unknown views
        of_map: dict[str, list[str]] = {name: [] for name in maps}
        unknown = []
        for view_id in filters.exclude:
            try:
                of_map[self._views.get(view_id).map].append(view_id)
            except (NotFound, KeyError):
                unknown.append(view_id)
        if unknown:
            raise InvalidParameters.of("exclude", f"no map of these has the views {', '.join(unknown)}")
        return [replace(filters, exclude=tuple(of_map[name])) for name in maps]

    def _keep_unknown(self, query_id: str, found: MapResults, data: bytes) -> None:
        """Keep a query that matched nothing, if its map says so.

        That it cannot be kept is logged, and its answer is given all the same.
        """
        if not found.results.keep_queries:
            return
        try:
            small = self._thumbnail(data, KEPT_SIZE)
            recipe = found.results.recipe.description
            self._kept.keep(found.name, query_id, recipe, found.description, small, datetime.now(UTC))
        except RevisitError as error:
            log.error("the query %s of map %s is not kept: %s", query_id, found.name, error.detail)

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


def _sums(timings: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Time of each stage over all maps."""
    stages = dict.fromkeys(chain.from_iterable(timings))
    return {stage: sum(one.get(stage, 0.0) for one in timings) for stage in stages}
