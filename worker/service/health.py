"""Health of a map: what makes its answers wrong or late to come, and what to do about it.

Everything is read from what is stored; no image is described for it.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from typing import Protocol

import numpy as np

from schemas.comparisons import MapLevels
from schemas.description import Appearance, Floats
from schemas.health import CODES, HealthFinding, HealthReport, SurveyedView
from schemas.latest import Latest
from schemas.recipe import DescriptionRecipe
from schemas.records import MapRecord
from worker.method import coverage
from worker.method.calibration import Calibration
from worker.method.camera_fixed import CameraFixed
from worker.method.near_duplicates import NEAR, SAME, alike, similarity
from worker.method.places import NEIGHBOURHOOD
from worker.service.match_standard import MatchStandard
from worker.service.ports import Maps
from worker.service.spots import (
    along,
    by_place,
    by_spot,
    coordinates,
    in_frame,
    known_position,
    label,
    listed,
    names_of,
    points_of,
)
from worker.service.twins import SHOWN, find_twins

EXAMINED = 20_000
"""Views of a map that are examined at most, the newest: bounds time and memory."""

NEAREST = 10
"""Later views that a view is compared with at most."""

PORTION = 100
"""Views whose cells are read together with those of their nearest later views."""

KEPT = 8
"""Maps whose report is kept until they change."""


class Surveys(Protocol):
    """Views of a map with their comparisons."""

    def survey(self, name: str, most: int) -> tuple[list[SurveyedView], int]:
        """The newest `most` described views and their number; raises NotFound."""
        ...

    def levels(self, name: str) -> MapLevels:
        """What wrong answers get in a map."""
        ...


class Descriptions(Protocol):
    """Parts of descriptions. Deleted views are absent."""

    def vectors(self, seqs: Sequence[int], recipe: str) -> dict[int, Floats]:
        """Histogram vectors."""
        ...

    def appearances(self, seqs: Sequence[int], recipe: str) -> dict[int, Appearance]:
        """Cells at half size, graphs and extents."""
        ...


class Ageing(Protocol):
    """Places whose scores fall, and those that are never matched."""

    def of(self, record: MapRecord, groups: Sequence[Sequence[SurveyedView]]) -> list[HealthFinding]:
        """Findings of a map whose views by place are `groups`, in any order; raises NotFound."""
        ...


class HealthService:
    """The use-case `health`. A report is made when it is asked for, one at a time, and kept until its map changes.

    Parameters
    ----------
    maps, comparisons, descriptions
        Parts of the store.
    calibration : function
        Map to the calibration of its confidences.
    camera_fixed : function
        Views and recipe to what is fixed to the camera that took them.
    ageing : Ageing
        Examined with each call: queries change it, and the map stays as it is.
    """

    def __init__(
        self,
        *,
        maps: Maps,
        comparisons: Surveys,
        descriptions: Descriptions,
        calibration: Callable[[MapRecord], Calibration],
        camera_fixed: Callable[[Sequence[int], DescriptionRecipe], CameraFixed | None],
        ageing: Ageing,
    ) -> None:
        self._maps, self._comparisons, self._descriptions = maps, comparisons, descriptions
        self._calibration, self._camera_fixed, self._ageing = calibration, camera_fixed, ageing
        self._kept: Latest[str, tuple[tuple[datetime, int], HealthReport, list[list[SurveyedView]]]] = Latest(KEPT)
        self._lock = threading.Lock()

    def of(self, name: str) -> HealthReport:
        """The health of a map; raises NotFound."""
        self._maps.get(name)  # an unknown map is refused without waiting for the report of another
        with self._lock:
            record = self._maps.get(name)
            state = record.created_at, record.revision
            kept = self._kept.get(name)
            if kept is None or kept[0] != state:
                kept = state, *self._examine(record)
            self._kept[name] = kept
            return replace(kept[1], findings=_ordered([*kept[1].findings, *self._ageing.of(record, kept[2])]))

    def _examine(self, record: MapRecord) -> tuple[HealthReport, list[list[SurveyedView]]]:
        views, described = self._comparisons.survey(record.name, EXAMINED)
        levels, within = self._comparisons.levels(record.name), record.ranking.same_place_m
        standard = MatchStandard(record.ranking.precision, levels, self._calibration(record))
        groups = by_place(views, within)
        found = [
            *find_twins(views, within, standard),
            *self._duplicates(views, record.description),
            *_narrow(views, groups, within),
        ]
        compared = sum(view.comparison is not None for view in views)
        return HealthReport(record.name, record.revision, described, len(views), compared, tuple(found)), groups

    def _duplicates(self, views: Sequence[SurveyedView], recipe: DescriptionRecipe) -> Iterator[HealthFinding]:
        vectors = self._descriptions.vectors([view.seq for view in views], recipe.id)
        rows = [view for view in views if view.seq in vectors]
        if len(rows) < 2:
            return
        near = alike(np.stack([vectors[view.seq] for view in rows]), NEAR, NEAREST)
        del vectors
        fixed = self._camera_fixed([view.seq for view in rows], recipe) if any(near) else None
        taken: set[int] = set()
        for start in range(0, len(rows), PORTION):
            portion = {i: near[i] for i in range(start, min(start + PORTION, len(rows))) if near[i] and i not in taken}
            wanted = sorted({rows[j].seq for i, later in portion.items() for j in (i, *later)})
            cells = self._descriptions.appearances(wanted, recipe.id)
            for i, later in portion.items():
                own = cells.get(rows[i].seq)
                if i in taken or own is None:
                    continue
                others = [(j, cells.get(rows[j].seq)) for j in sorted(later) if j not in taken]
                same = [j for j, of in others if of is not None and similarity(own.coarse, of.coarse, fixed) >= SAME]
                if same:
                    taken.update(same)
                    yield _duplicate([rows[i], *(rows[j] for j in same)])


def _ordered(found: list[HealthFinding]) -> tuple[HealthFinding, ...]:
    return tuple(sorted(found, key=lambda finding: (CODES.index(finding.code), -finding.weight, finding.views)))


def _duplicate(views: Sequence[SurveyedView]) -> HealthFinding:
    names = sorted({view.known.name for view in views if view.known.name is not None})
    first = views[0].id
    detail = f"{len(views)} views are nearly the same image; all but one add nothing"
    remedy = f"keep {first}, the first one, and delete the others (DELETE /views/{{id}})"
    if len(names) > 1:
        detail = f"{len(views)} views are nearly the same image, and are enrolled as {listed(names)}"
        remedy = "delete those that are enrolled as the wrong place, or give all of them one place (PATCH /views/{id})"
    ids = tuple(view.id for view in views)
    return HealthFinding(
        "duplicates",
        detail,
        remedy,
        weight=len(views) + 1000.0 * (len(names) > 1),
        places=tuple(names),
        views=ids[:SHOWN],
        count=len(views),
    )


def _narrow(
    views: Sequence[SurveyedView], groups: Sequence[Sequence[SurveyedView]], same_place_m: float
) -> Iterator[HealthFinding]:
    """Places seen from one side or once only, and stretches without views."""
    for geographic in (False, True):
        yield from _gaps(in_frame(views, geographic), same_place_m, geographic)
    for group in groups:
        yield from _directions(group)
        if len(group) == 1:
            [view] = group
            yield HealthFinding(
                "single-view",
                f"{label(view)} has one view only",
                "enrol it once more, in other light or from a few steps aside",
                weight=0.0,
                places=names_of(group),
                views=(view.id,),
                count=1,
                position=known_position(view),
            )


def _directions(group: Sequence[SurveyedView]) -> Iterator[HealthFinding]:
    headings = [view.known.position.heading for view in group if view.known.position.heading is not None]
    missing = coverage.missing_directions(headings)
    if missing:
        where = known_position(group[0])
        stand = f"stand at {label(group[0])}" + (f" ({coordinates(where)})" if where and group[0].known.name else "")
        towards = listed([f"{name} ({coverage.QUARTERS[name]:.0f}°)" for name in missing])
        yield HealthFinding(
            "missing-directions",
            f"{label(group[0])} is not seen towards {listed(missing)}",
            f"{stand}, photograph {towards}",
            weight=len(missing) + min(len(group), 1000) / 1001,
            places=names_of(group),
            views=tuple(view.id for view in group[:SHOWN]),
            count=len(group),
            position=where,
            headings=tuple(coverage.QUARTERS[name] for name in missing),
        )


def _gaps(views: Sequence[SurveyedView], same_place_m: float, geographic: bool) -> Iterator[HealthFinding]:
    firsts = [group[0] for group in by_spot(views, same_place_m)]
    for one, other, straight in coverage.gaps(points_of(firsts), NEIGHBOURHOOD * same_place_m):
        ends, length = (firsts[one], firsts[other]), along(straight, geographic)
        yield HealthFinding(
            "gap",
            f"between {label(ends[0])} and {label(ends[1])} there are {length:.0f} m without a view, much more than "
            "is usual in this map",
            "if one can go from one to the other, enrol views along the way",
            weight=length,
            places=tuple(sorted({*names_of(ends[:1]), *names_of(ends[1:])})),
            views=(ends[0].id, ends[1].id),
            count=2,
            position=known_position(ends[0]),
        )
