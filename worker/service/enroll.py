"""Enrol an image: store it, have it described, report the outcome."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from schemas.errors import Busy, NothingStatic, RevisitError
from schemas.image import Image
from schemas.recipe import MapRecipe
from schemas.records import Submitted, ViewAttributes, ViewRecord
from worker.images.codec import facts
from worker.service import steady
from worker.service.ports import Enrolment, JobQueue, Maps, Removals, Views
from worker.service.settlements import Settlements


@dataclass(frozen=True)
class Accepted:
    """An image that is stored durably, described or not.

    Parameters
    ----------
    submitted : Submitted
    began : float
        Reading of `time.perf_counter` when the call began.
    timing_ms : mapping of stage to milliseconds
    """

    submitted: Submitted
    began: float
    timing_ms: dict[str, float]


@dataclass(frozen=True)
class Enrolled:
    """The outcome of an enrolment.

    Parameters
    ----------
    view : ViewRecord
    labels : tuple of str
        Label set of the view's map; empty while the view is not described.
    created : bool
        False when the same bytes were in the map already.
    revision : int
        Of the map, after this enrolment.
    job_id : str or None
        The job that describes the view, while the view is pending.
    timing_ms : mapping of stage to milliseconds
    """

    view: ViewRecord
    labels: tuple[str, ...]
    created: bool
    revision: int
    job_id: str | None
    timing_ms: dict[str, float]


class EnrollService:
    """The use-case `enroll`.

    Parameters
    ----------
    maps, enrolment, views, removals, queue
        Parts of the store.
    settlements : Settlements
        Waits for a view to be described.
    decode : function
        Bytes to Image; raises BadImage.
    default_recipe : MapRecipe
        Recipe of a map that its first enrolment creates.
    limit : int
        Enrolments that may wait; more are refused with Busy.
    pace_s : function
        Returns the measured seconds per image.
    wake : function
        Called when a description was queued.
    """

    def __init__(
        self,
        *,
        maps: Maps,
        enrolment: Enrolment,
        views: Views,
        removals: Removals,
        queue: JobQueue,
        settlements: Settlements,
        decode: Callable[[bytes], Image],
        default_recipe: MapRecipe,
        limit: int,
        pace_s: Callable[[], float],
        wake: Callable[[], None],
    ) -> None:
        self._maps, self._enrolment, self._views, self._removals = maps, enrolment, views, removals
        self._queue, self._settlements = queue, settlements
        self._decode, self._default_recipe = decode, default_recipe
        self._limit, self._pace_s, self._wake = limit, pace_s, wake

    def submit(self, data: bytes, map_name: str, attributes: ViewAttributes) -> Accepted:
        """Store an image durably and queue its description.

        Raises
        ------
        BadImage, Busy, Conflict, DiskFull
            Nothing is stored.
        """
        began = time.perf_counter()
        image = self._decode(data)
        decoded = time.perf_counter()
        waiting = self._queue.count_waiting()
        if waiting >= self._limit:
            raise Busy.queue(waiting, self._pace_s(), "enrolments")
        submitted = self._enrolment.submit(
            map_name, data, facts(image), attributes, self._default_recipe, datetime.now(UTC), steady.reading_s()
        )
        if submitted.job_id is not None:
            self._wake()
        return Accepted(submitted, began, {"decode": (decoded - began) * 1000, "store": _since(decoded)})

    def outcome(self, accepted: Accepted, view: ViewRecord | None = None) -> Enrolled:
        """The outcome of an accepted image.

        Parameters
        ----------
        accepted : Accepted
        view : ViewRecord, optional
            The view after waiting for its description; None when the call does not wait.

        Raises
        ------
        NothingStatic
            The view is kept, `failed`.
        RevisitError
            Describing the image failed; a view that this call created is removed.
        """
        submitted = accepted.submitted
        record = submitted.view if view is None else view
        if view is not None and record.state == "failed" and record.failure is not None:
            code, detail = record.failure
            if code == NothingStatic.code:
                raise NothingStatic(f"{detail} (kept as view {record.id}, which no search will return)")
            if submitted.created:  # a view that an earlier call acknowledged stays
                self._removals.delete_view(record.id)
            raise RevisitError(detail)
        revision = submitted.revision
        labels: tuple[str, ...] = ()
        if record.state == "ready":
            owner = self._maps.get(record.map)
            revision, labels = owner.revision, owner.description.labels
        return Enrolled(
            view=record,
            labels=labels,
            created=submitted.created,
            revision=revision,
            job_id=submitted.job_id if record.state == "pending" else None,
            timing_ms={**accepted.timing_ms, "total": _since(accepted.began)},
        )

    def enroll(self, data: bytes, map_name: str, attributes: ViewAttributes, *, patience_s: float) -> Enrolled:
        """Submit an image, wait up to `patience_s` for its description; raises as `submit` and `outcome`."""
        accepted = self.submit(data, map_name, attributes)
        if accepted.submitted.job_id is None:
            return self.outcome(accepted)
        describing = time.perf_counter()
        view = self._settlements.wait(accepted.submitted.view.id, patience_s)
        timing = {**accepted.timing_ms, "describe": _since(describing)}
        return self.outcome(replace(accepted, timing_ms=timing), view)


def _since(moment: float) -> float:
    """Milliseconds since a reading of `time.perf_counter`."""
    return (time.perf_counter() - moment) * 1000
