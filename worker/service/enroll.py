"""Enrol an image: store it, have it described, report the outcome."""

import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, Protocol

from schemas.enrolment import EnrolmentOptions
from schemas.errors import (
    Busy,
    Cancelled,
    DiskFull,
    NotFound,
    NothingStatic,
    PoorImage,
    RevisitError,
    StorageFailed,
    Unavailable,
)
from schemas.image import Image
from schemas.recipe import MapRecipe
from schemas.records import Submitted, ViewAttributes, ViewRecord
from worker.service import moving, steady
from worker.service.blurring import BlurringEnrolment
from worker.service.caller import Caller
from worker.service.completing import completed
from worker.service.ports import JobQueue, Maps, Removals, Views
from worker.service.resemblances import Resemblance
from worker.service.settlements import Settlements
from worker.service.views import labelled
from worker.service.waiting_room import WaitingRoom

NO_WORKER_RETRY_S = 10

KEPT = "kept as view {}, which no search will return"


class Workers(Protocol):
    """Who describes what is enrolled."""

    @property
    def able(self) -> int:
        """How many are alive that can."""
        ...

    @property
    def nobody(self) -> str | None:
        """Why there is none, in words; None while there is one."""
        ...


@dataclass(frozen=True)
class Accepted:
    """An image that is stored durably, described or not.

    Parameters
    ----------
    submitted : Submitted
    began : float
        Reading of `time.perf_counter` when the call began.
    expected_s : float
        Seconds until it is described, by the length of the queue and the measured pace.
    problem : str or None
        What may keep it from being recognised, in words.
    timing_ms : mapping of stage to milliseconds
    judged : bool
        Whether the only worker refuses near-duplicates, so that no other can have kept one meanwhile.
    """

    submitted: Submitted
    began: float
    expected_s: float
    problem: str | None
    timing_ms: dict[str, float]
    judged: bool = False


@dataclass(frozen=True)
class Enrolled:
    """The outcome of an enrolment.

    Parameters
    ----------
    view : ViewRecord
    labels : tuple of str
        Of the recipe that the view is described by; empty while it is not described.
    created : bool
        False when the same bytes were in the map already.
    revision : int
        Of the map, after this enrolment.
    job_id : str or None
        The job that describes the view, while the view is pending.
    problem : str or None
        What may keep the view from being recognised, in words.
    resembles : tuple of Resemblance
        What a view that this call created and that is described resembles.
    timing_ms : mapping of stage to milliseconds
    """

    view: ViewRecord
    labels: tuple[str, ...]
    created: bool
    revision: int
    job_id: str | None
    problem: str | None
    resembles: tuple[Resemblance, ...]
    timing_ms: dict[str, float]


class EnrollService:
    """The use-case `enroll`.

    Parameters
    ----------
    maps, views, removals, queue
        Parts of the store.
    enrolment : BlurringEnrolment
    settlements : Settlements
        Waits for a view to be described.
    room : WaitingRoom
        Where images wait before they are decoded.
    read_exif : function
        Bytes to what their EXIF says of place and time, by our names.
    look_for_problem : function
        What is wrong with an image, in words, or None.
    default_recipe : MapRecipe
        Recipe of a map that its first enrolment creates.
    limit : int
        Enrolments that may wait; more are refused with Busy.
    pace_s : function
        Returns the measured seconds per image.
    wake : function
        Called when a description was queued.
    workers : Workers
    resembles : function
        What a described view resembles in its map, and whether near-duplicates of it are known to be none.
    describer : function
        Raises SetupError where the running encoder cannot describe the views of a map, NotFound where there is none.
    """

    def __init__(
        self,
        *,
        maps: Maps,
        enrolment: BlurringEnrolment,
        views: Views,
        removals: Removals,
        queue: JobQueue,
        settlements: Settlements,
        room: WaitingRoom,
        read_exif: Callable[[bytes], Mapping[str, Any]],
        look_for_problem: Callable[[Image], str | None],
        default_recipe: MapRecipe,
        limit: int,
        pace_s: Callable[[], float],
        wake: Callable[[], None],
        workers: Workers,
        resembles: Callable[[ViewRecord, bool], tuple[Resemblance, ...]],
        describer: Callable[[str], object],
    ) -> None:
        self._maps, self._enrolment, self._views, self._removals = maps, enrolment, views, removals
        self._queue, self._settlements = queue, settlements
        self._room, self._read_exif = room, read_exif
        self._look_for_problem, self._default_recipe = look_for_problem, default_recipe
        self._limit, self._pace_s, self._wake, self._workers = limit, pace_s, wake, workers
        self._resembles, self._describer = resembles, describer

    def submit(
        self,
        data: bytes,
        map_name: str,
        attributes: ViewAttributes,
        *,
        waits: bool = False,
        refuse_poor: bool | None = None,
        exif: bool = False,
        makes_map: bool = True,
    ) -> Accepted:
        """Store an image durably and queue its description.

        Parameters
        ----------
        data : bytes
        map_name : str
        attributes : ViewAttributes
        waits : bool
            Whether the caller wants to wait for the description, which is refused when no worker is there to make it.
        refuse_poor : bool, optional
            Whether an image that is dark, overexposed, covered or blurred is not to be enrolled, and whether the view
            of one is to fail that shows mostly things that move or is nearly in the map already; None: as the map says.
        exif : bool
            Whether the image's EXIF says where and when it was taken, where `attributes` do not.
        makes_map : bool
            Whether a map is made that there is not.

        Raises
        ------
        BadImage, PoorImage, NothingStatic, Busy, Conflict, DiskFull, StorageFailed, Unavailable
            Nothing is stored.
        NotFound
            There is no map, and none is made.
        SetupError
            The map was described by another encoder than the running one; nothing is stored.
        """
        began = time.perf_counter()
        with suppress(NotFound):  # it is made, by the running encoder
            self._describer(map_name)
        with self._room.decoded(data, Caller()) as decoded:
            storing = time.perf_counter()
            problem = self._look_for_problem(decoded.image)
            refuses_poor = self._maps.refuses_poor(map_name) if refuse_poor is None else refuse_poor
            if problem is not None and refuses_poor:
                raise PoorImage(problem)
            waiting, workers = self._admit(waits)
            if exif:
                attributes = completed(attributes, self._read_exif(data))
            recipe = self._default_recipe if makes_map else None
            options = EnrolmentOptions(datetime.now(UTC), recipe, steady.reading_s(), refuse_poor=refuses_poor)
            submitted = self._enrolment.submit(map_name, data, decoded.image, attributes, options)
        if submitted.job_id is not None:
            self._wake()
        expected_s = (waiting + 1) * self._pace_s() / max(1, workers)
        timing_ms = {"decode": decoded.waited_ms + decoded.decode_ms, "store": _since(storing)}
        return Accepted(submitted, began, expected_s, problem, timing_ms, refuses_poor and workers <= 1)

    def _admit(self, waits: bool) -> tuple[int, int]:
        """How many images wait to be described, and how many workers describe them; raises as `submit`."""
        waiting = self._queue.count_waiting()
        if waiting >= self._limit:
            raise Busy.queue(waiting, self._pace_s(), "enrolments")
        workers, nobody = self._workers.able, self._workers.nobody
        if waits and nobody is not None:
            raise Unavailable(f"{nobody}; with wait=false the image is kept until one comes", NO_WORKER_RETRY_S)
        if waits and isinstance(self._settlements.trouble, DiskFull | StorageFailed):
            raise self._settlements.trouble
        return waiting, workers

    def take(self, data: bytes, map_name: str, attributes: ViewAttributes) -> Enrolled:
        """Submit the image of a kept query that somebody decided to enrol; raises as `submit`.

        A map that was deleted meanwhile is not made again, and the image is taken even where the map refuses poor ones.
        """
        return self.outcome(self.submit(data, map_name, attributes, refuse_poor=False, makes_map=False))

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
        PoorImage
            The image shows mostly things that move, or adds nothing to the map, and such images are refused; a view
            that this call created is removed, unless another call was told of it meanwhile.
        Cancelled
            Somebody cancelled the description; a view that this call created is removed, as above.
        DiskFull, StorageFailed
            The description cannot be stored now, and the view that this call created is removed. Where it cannot be
            removed, or was there before, it stays pending and is described later: that is no error.
        RevisitError
            Describing the image failed; a view that this call created is removed, as above.
        """
        submitted = accepted.submitted
        record = submitted.view if view is None else view
        trouble = self._settlements.trouble
        if view is not None and record.state == "pending" and trouble is not None and self._undone(submitted):
            raise trouble
        if view is not None and record.state == "failed" and record.failure is not None:
            code, detail = record.failure
            if code == NothingStatic.code:
                raise NothingStatic(f"{detail} ({KEPT.format(record.id)})")
            if not self._undone(submitted):  # a view that another call was told of stays
                detail = f"{detail} ({KEPT.format(record.id)})"
            if code == PoorImage.code:
                raise PoorImage(detail)
            raise Cancelled(detail) if code == Cancelled.failure else RevisitError(detail)
        try:
            return self._enrolled(accepted, view)
        except StorageFailed:
            if submitted.job_id is None:  # this call has stored nothing
                raise
        # It is durable, whatever cannot be read of it now: as if the caller had not waited.
        timing_ms = {**accepted.timing_ms, "total": _since(accepted.began)}
        return Enrolled(
            view=submitted.view,
            labels=(),
            created=submitted.created,
            revision=submitted.revision,
            job_id=submitted.job_id,
            problem=accepted.problem,
            resembles=(),
            timing_ms=timing_ms,
        )

    def _enrolled(self, accepted: Accepted, view: ViewRecord | None) -> Enrolled:
        """The outcome of an image that was taken; raises StorageFailed where it cannot be read."""
        submitted = accepted.submitted
        record = submitted.view if view is None else view
        problem = accepted.problem
        if view is not None and submitted.created:
            problem = problem or self._moves(record)
        revision = submitted.revision
        resembles: tuple[Resemblance, ...] = ()
        timing_ms = accepted.timing_ms
        if record.state == "ready" and submitted.created:
            comparing = time.perf_counter()
            resembles = self._resembles(record, accepted.judged)
            timing_ms = {**timing_ms, "compare": _since(comparing)}
        if record.state == "ready":
            revision = self._maps.get(record.map).revision
        [shown] = labelled([record], self._maps)
        return Enrolled(
            view=shown.record,
            labels=shown.labels,
            created=submitted.created,
            revision=revision,
            job_id=submitted.job_id if record.state == "pending" else None,
            problem=problem,
            resembles=resembles,
            timing_ms={**timing_ms, "total": _since(accepted.began)},
        )

    def _moves(self, record: ViewRecord) -> str | None:
        """What is wrong with an image that shows mostly things that move; None also when its map changed over."""
        recipe = self._maps.get(record.map).description
        described = record.description
        if record.state != "ready" or described is None or described.recipe != recipe.id:
            return None
        return moving.problem_of(described.label_shares, described.static_share, recipe)

    def _undone(self, submitted: Submitted) -> bool:
        """Whether the view of a call that will be answered with an error is removed; one that others know of stays."""
        if not submitted.created:
            return False
        try:
            self._removals.delete_view(submitted.view.id, undoes=True)
        except NotFound:
            return True
        except RevisitError:
            return False
        return True

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
