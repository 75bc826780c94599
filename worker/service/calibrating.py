"""Calibrate the confidences of a map on its user's own labelled queries."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache

import numpy as np

from schemas.comparisons import KnownView
from schemas.description import Indices
from schemas.errors import Conflict, InvalidParameters, NotFound, ParameterError, Unavailable
from schemas.recipe import MapRecipe
from schemas.records import Filters, MapRecord, Position, Selection, ViewRecord
from schemas.values import spellings
from worker.description.describers import Describers
from worker.method.byte_vectors import Product
from worker.method.calibration import Calibration
from worker.method.cascade import ViewGone
from worker.method.own_calibration import Fitted, Labelled, OwnCalibration, calibrate, consecutive_blocks
from worker.method.positions import distance, is_known
from worker.search.fetcher import Fetcher
from worker.search.ports import Catalogue
from worker.service.comparing import Descriptions
from worker.service.map_answers import ROUNDS, AnsweringMap
from worker.service.ports import Comparisons, Listings, Maps, Views


@dataclass(frozen=True)
class ObservedAnswer:
    """What was seen of an answer that the map gave, and whether its first place was right.

    Parameters
    ----------
    features : mapping of name to float
        Of the decision; empty for an answer without any match, which says nothing.
    right : bool
    known : bool
        Whether the map has the place.
    block : str or None
        Queries of one block are judged together.
    """

    features: Mapping[str, float]
    right: bool
    known: bool = True
    block: str | None = None


@dataclass(frozen=True)
class LabelledView:
    """An enrolled view to query the map with, itself left out, and the place that it shows.

    Parameters
    ----------
    view : str
        Its id.
    place : str or None
        Name of the right place; None, without a position: none of the map's places.
    position : Position or None
        Where the right place is.
    block : str or None
    """

    view: str
    place: str | None = None
    position: Position | None = None
    block: str | None = None


@dataclass(frozen=True)
class CalibrationResult:
    """What came of a calibration.

    Parameters
    ----------
    record : MapRecord
        The map afterwards.
    fitted : Fitted
    labelled : Labelled
    kept : bool
        Whether the map uses it from now on.
    trial : bool
        Whether nothing was to be kept.
    precision : float
        Of the map: where both calibrations were judged.
    unanswered : int
        Queries without any match, which were left out.
    """

    record: MapRecord
    fitted: Fitted
    labelled: Labelled
    kept: bool
    trial: bool
    precision: float
    unanswered: int


class CalibrationService:
    """The use-cases around a map's own calibration.

    Parameters
    ----------
    maps, views, listings, descriptions, comparisons
        Parts of the store.
    catalogue : Catalogue
    describers : Describers
    shipped : function
        Recipe to the calibration shipped for it.
    product : Product
        Multiplies dense cells.
    """

    def __init__(
        self,
        *,
        maps: Maps,
        views: Views,
        listings: Listings,
        descriptions: Descriptions,
        comparisons: Comparisons,
        catalogue: Catalogue,
        describers: Describers,
        shipped: Callable[[MapRecipe], Calibration],
        product: Product,
    ) -> None:
        self._maps, self._views, self._listings = maps, views, listings
        self._descriptions, self._comparisons = descriptions, comparisons
        self._catalogue, self._describers, self._shipped, self._product = catalogue, describers, shipped, product

    def calibrate(
        self,
        name: str,
        observed: Sequence[ObservedAnswer],
        queries: Sequence[LabelledView],
        *,
        recipe: str | None = None,
        ranking: str | None = None,
        within_m: float = 0.0,
        trial: bool = False,
    ) -> CalibrationResult:
        """Fit and judge a calibration; keep it if it does not do worse than the shipped one on held-out queries.

        Parameters
        ----------
        name : str
            Of the map.
        observed : sequence of ObservedAnswer
            In the order in which the images were taken.
        queries : sequence of LabelledView
            Answered now, after `observed` in order.
        recipe, ranking : str or None
            Ids in the observed answers, to be compared with the map's.
        within_m : float
            A first place this near a labelled position is right, metres; at least the map's `same_place_m`.
        trial : bool
            Keep nothing.

        Raises
        ------
        NotFound, InvalidParameters
        Conflict
            The map's recipe or ranking is not, or no longer, the one that gave the answers.
        Unavailable
        """
        record = self._maps.get(name)
        for what, given, present in (
            ("recipe", recipe, record.description.id),
            ("ranking", ranking, record.ranking.id),
        ):
            if given not in (None, present):
                raise Conflict(f"the {what} of the map {name!r} is {present}, and {given} gave the observed answers")
        shipped = self._shipped(record.recipe)
        views = self._check(record, observed, queries, shipped.features)
        within = max(within_m, record.ranking.same_place_m)
        every = [*observed, *(self._observe(record, v, q, within) for v, q in zip(views, queries, strict=True))]
        answered = [one for one in every if one.features]
        labelled = Labelled(
            features=np.array([[one.features[f] for f in shipped.features] for one in answered]).reshape(
                len(answered), len(shipped.features)
            ),
            right=np.array([one.right for one in answered], np.bool_),
            known=np.array([one.known for one in answered], np.bool_),
            blocks=_blocks(answered),
        )
        if lacks := labelled.missing():
            raise InvalidParameters([ParameterError("queries" if queries else "observed", lack) for lack in lacks])
        fitted = calibrate(labelled, shipped, record.ranking.precision)
        kept = fitted.transfers and not trial
        after = record
        if kept:
            own = replace(fitted.own, made_at=datetime.now(UTC).isoformat())
            after = self._maps.set_calibration(name, own.to_json(), record.recipe)
        return CalibrationResult(
            record=after,
            fitted=fitted,
            labelled=labelled,
            kept=kept,
            trial=trial,
            precision=record.ranking.precision,
            unanswered=len(every) - len(answered),
        )

    def forget(self, name: str) -> None:
        """Return a map to the shipped calibration; raises NotFound."""
        self._maps.set_calibration(name, None)

    def _check(
        self,
        record: MapRecord,
        observed: Sequence[ObservedAnswer],
        queries: Sequence[LabelledView],
        features: Sequence[str],
    ) -> list[ViewRecord]:
        """The views of the queries; raises InvalidParameters with all that is wrong."""
        errors, views = [], []
        for i, one in enumerate(observed):
            if one.features and (lacking := [f for f in features if f not in one.features]):
                detail = f"lacks {' and '.join(lacking)}; send all that `decision.features` of the answer has"
                errors.append(ParameterError(f"observed.{i}.features", detail))
        named = {query.place for query in queries if query.place is not None}
        empty = {place for place in named if not self._showing(record.name, Filters(place=place))}
        frames = _frames(self._maps.counts(record.name).lowest)
        for i, query in enumerate(queries):
            if query.position is not None and _frame(query.position) not in frames:
                detail = f"is in {_frame(query.position)}, in which no view of the map has a position"
                errors.append(ParameterError(f"queries.{i}.position", detail))
            if query.place in empty:
                detail = f"no view of the map shows {query.place!r}; null means none of its places"
                errors.append(ParameterError(f"queries.{i}.place", detail))
            try:
                view = self._views.get(query.view)
                found = view.map == record.name
            except NotFound:
                found = False
            if not found:  # the same for a view of another map, which the caller may not know of
                detail = f"there is no view {query.view!r} in the map {record.name!r}"
                errors.append(ParameterError(f"queries.{i}.view", detail))
                continue
            if view.state != "ready":
                errors.append(ParameterError(f"queries.{i}.view", f"is {view.state}; only described views can query"))
            views.append(view)
        if errors:
            raise InvalidParameters(errors)
        return views

    def _observe(self, record: MapRecord, view: ViewRecord, query: LabelledView, within: float) -> ObservedAnswer:
        """Query the map with one of its views, itself left out."""
        gone: frozenset[int] = frozenset()
        for _ in range(ROUNDS):
            index, now = self._catalogue.index(record.name)
            description = self._descriptions.whole(view.seq, now.description)
            if description is None or now.description.id != record.description.id:
                raise Conflict(f"the view {view.id} was deleted, or its map was described anew, in the meantime")
            fixed = [self._catalogue.camera_fixed(index, now.description)]
            fetcher = Fetcher(self._descriptions, self._comparisons, now.description.id, fixed=fixed)
            levels, impostors = self._comparisons.levels(record.name), self._describers.impostors(now.description)
            answering = AnsweringMap(
                now.recipe, index, fetcher, levels, self._shipped(now.recipe), impostors, self._product
            )
            try:
                others = Selection(None, np.array(sorted({view.seq, *gone})))
                ranking, decision = answering.answer(description, others)
                first = fetcher.known([int(seq) for seq in ranking.seqs[:1]])
            except ViewGone as error:
                gone |= error.seqs
                continue
            right = any(_shows(known, query, within) for known in first)
            return ObservedAnswer(decision.features, right, right or self._knows(view, query, within), query.block)
        raise Unavailable("the map is being emptied faster than it can be searched; try again", 1)

    def _knows(self, view: ViewRecord, query: LabelledView, within: float) -> bool:
        """Whether the map has a view of the query's place besides the query itself."""
        if query.position is not None and is_known(query.position):
            filters = Filters.around(query.position, within)
        elif query.place is not None:
            filters = Filters(place=query.place)
        else:
            return False
        return bool(self._showing(view.map, filters) - {view.seq})

    def _showing(self, name: str, filters: Filters) -> set[int]:
        only = self._listings.select(name, filters).only
        return set() if only is None else {int(seq) for seq in only}


def _frame(position: Position) -> str:
    return "metres" if position.lat is None else "degrees"


def _frames(lowest: Position) -> list[str]:
    """Frames of the positions of a map, by its lowest ones."""
    return [name for name, value in (("metres", lowest.x), ("degrees", lowest.lat)) if value is not None]


def _shows(known: KnownView, query: LabelledView, within: float) -> bool:
    """Whether a view shows the right place."""
    if query.position is not None:
        return distance(known.position, query.position) <= within
    return query.place is not None and known.name in spellings(query.place)


def _blocks(answers: Sequence[ObservedAnswer]) -> Indices:
    """Block of each answer, intp (n,): those that were named, and runs of the others."""
    runs = consecutive_blocks(len(answers))
    keys = [f"named {a.block}" if a.block is not None else f"run {run}" for a, run in zip(answers, runs, strict=True)]
    return np.unique(np.array(keys), return_inverse=True)[1] if keys else runs


@lru_cache(maxsize=256)
def own_calibration(text: str) -> OwnCalibration:
    """A map's own calibration from its JSON."""
    return OwnCalibration.from_json(text)
