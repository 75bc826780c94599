"""Import recordings: enrol the images of an upload, as a durable job."""

import hashlib
import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextvars import copy_context
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any, NamedTuple

from schemas.enrolment import EnrolmentOptions
from schemas.errors import (
    Conflict,
    EncoderAway,
    JobStopped,
    LeaseLost,
    NotFound,
    PoorImage,
    RevisitError,
    StorageFailed,
    unforeseen,
)
from schemas.image import Image
from schemas.imports import ImportOptions
from schemas.records import MapClaim, Submitted, ViewAttributes, ViewRecord
from worker.description.priority import step_aside
from worker.images.apart.stream import Repeated
from worker.service import steady
from worker.service.blurring import BlurringEnrolment
from worker.service.completing import completed, turned, wanted_of_exif
from worker.service.enroll import KEPT
from worker.service.import_ports import ImportJobs, Uploads
from worker.service.import_report import Report
from worker.service.opening import open_recording
from worker.service.panoramas import Panoramas
from worker.service.ports import Removals
from worker.service.recordings import Item, Limits, Note
from worker.service.settlements import Settlements
from worker.service.trouble import STORAGE_ERRORS

log = logging.getLogger("revisit.worker")

AHEAD = 32
"""Images stored ahead of the encoder, and fewer of large ones: those that do not fit are decoded a second time."""

LEAST_AHEAD = 3
"""Images stored ahead however large they are: one is encoded, one is claimed, and the next is there in time."""

DECODED_AHEAD = 4
"""Images read and decoded ahead of the store."""

TOLD_EVERY_S = 0.5
"""Seconds between reports of progress, which also learn of a cancellation."""

PAUSE_S = 0.02


class Importer:
    """Runs jobs of the kind ``import``.

    Parameters
    ----------
    uploads, jobs, removals
        Parts of the store.
    enrolment : BlurringEnrolment
    settlements : Settlements
        Waits for views to be described.
    decode : function
        Bytes to Image; raises BadImage.
    read_exif : function
        Bytes to what their EXIF says, by the names of attributes; raises BadImage.
    look_for_problem : function
        What is wrong with an image, in words, or None.
    limits : Limits
    ahead_bytes : int
        Of the pixels of images that are stored ahead of the encoder.
    wake : function
        Called when a description was queued.
    """

    def __init__(
        self,
        *,
        uploads: Uploads,
        jobs: ImportJobs,
        removals: Removals,
        enrolment: BlurringEnrolment,
        settlements: Settlements,
        decode: Callable[[bytes], Image],
        read_exif: Callable[[bytes], Mapping[str, Any]],
        look_for_problem: Callable[[Image], str | None],
        limits: Limits,
        ahead_bytes: int,
        wake: Callable[[], None],
    ) -> None:
        self._uploads, self._jobs, self._enrolment, self._settlements = uploads, jobs, enrolment, settlements
        self._decode, self._read_exif, self._look_for_problem = decode, read_exif, look_for_problem
        self._limits, self._wake, self._removals = limits, wake, removals
        self.ahead_bytes = ahead_bytes

    def run(self, claim: MapClaim, stopping: Callable[[], bool]) -> None:
        """Import a recording until `stopping()` is true; what is there already is skipped, an error fails the job.

        Raises
        ------
        DiskFull, StorageFailed
            The job was put back, and is to be tried again.
        """
        try:
            with (
                self._uploads.opened(claim.job_id, lambda: self._watch(claim, stopping)) as (path, wanted),
                open_recording(path, self._limits, options := ImportOptions(**wanted)) as recording,
            ):
                items = Panoramas(self._decode).split(recording.items) if options.panorama else recording.items
                report = Report(len(items) + recording.failed, failed=recording.failed, left_out=recording.left_out)
                for note in recording.notes:
                    report.rows_without_file += note.problem == "no-file"
                    report.files_without_row += note.problem == "no-row"
                    report.add(note)
                exif = wanted_of_exif(items) if options.exif else frozenset()
                run = _Run(self, claim, stopping, report, exif, bool(options.refuse_poor), recording.close)
                with ThreadPoolExecutor(1, "revisit-importing", initializer=step_aside) as thread:
                    thread.submit(copy_context().run, run.all, items).result()
            self._jobs.finish_import(claim, report.progress, asdict(report), _now())
        except (JobStopped, EncoderAway):  # the latter where the service stops while the encoder that blurs is away
            self._jobs.release_map_job(claim)
            return
        except LeaseLost:
            if not self._is_over(claim):
                log.info("job %s was taken from this worker, which was silent for too long", claim.job_id)
                return  # whoever goes on with it needs the recording
            log.info("job %s was cancelled, or its map was deleted", claim.job_id)
        except STORAGE_ERRORS:
            self._jobs.release_map_job(claim)
            raise
        except FileNotFoundError:
            self._jobs.fail_map_job(
                claim, "damaged", "the uploaded recording is gone from where it was kept; send it again", _now()
            )
        except OSError as error:
            self._jobs.release_map_job(claim)
            raise StorageFailed(f"the uploaded recording cannot be read: {error.strerror}") from error
        except RevisitError as error:
            self._jobs.fail_map_job(claim, error.code, error.detail, _now())
        except Exception as error:
            log.exception("importing into the map %s failed", claim.map)
            self._jobs.fail_map_job(claim, "internal", unforeseen(error), _now())
        self._uploads.discard(claim.job_id)

    def _watch(self, claim: MapClaim, stopping: Callable[[], bool]) -> None:
        """While a recording is fetched: raises JobStopped, LeaseLost."""
        if stopping():
            raise JobStopped
        try:
            state = self._jobs.get(claim.job_id).state
        except NotFound as error:
            raise LeaseLost(error.detail) from None
        if state != "running":
            raise LeaseLost(f"the job {claim.job_id} is {state}")

    def _is_over(self, claim: MapClaim) -> bool:
        """Whether a job has ended or went with its map; else it is another worker's, or waits for one."""
        try:
            return self._jobs.get(claim.job_id).state not in ("waiting", "running")
        except NotFound:
            return True

    # what a run of a job does with one image

    def read(self, claim: MapClaim, item: Item, exif: frozenset[str], began: datetime | None) -> "_Read":
        """Read an image, and find its view in the map, else decode it; raises ValueError, RevisitError.

        An image whose view is in the map is examined too if it was enrolled since the job `began`: an earlier run of
        the job may have enrolled it, and the report is made anew.
        """
        data = item.read()
        attributes = item.attributes
        if exif:
            known = self._read_exif(data if item.original is None else item.original())
            attributes = completed(attributes, {name: value for name, value in known.items() if name in exif})
        attributes = turned(attributes, item.turn)
        view = self._enrolment.known(claim.map, hashlib.sha256(data).hexdigest(), attributes)
        if view is not None and (began is None or view.enrolled_at < began):
            return _Read(data, attributes, view, None, None)
        image = self._decode(data)
        return _Read(data, attributes, view, None if view else image, self._look_for_problem(image))

    def submit(
        self, claim: MapClaim, data: bytes, attributes: ViewAttributes, image: Image, refuse_poor: bool
    ) -> Submitted:
        """Store an image durably and queue its description.

        Raises ViewDeleted, Conflict, LeaseLost, DiskFull, StorageFailed.
        """
        options = EnrolmentOptions(
            _now(), steady_s=steady.reading_s(), background=True, refuse_poor=refuse_poor, job=claim
        )
        try:
            submitted = self._enrolment.submit(claim.map, data, image, attributes, options)
        except NotFound as error:
            raise LeaseLost(error.detail) from None
        if submitted.job_id is not None:
            self._wake()
        return submitted

    def settled(self, view_id: str, patience_s: float) -> ViewRecord | None:
        """A view once it is settled, or as it is after `patience_s`; None when it was deleted."""
        try:
            return self._settlements.wait(view_id, patience_s)
        except NotFound:
            return None

    def drop(self, view_id: str) -> bool:
        """Remove a view, unless a call was told of it; whether it is gone."""
        try:
            self._removals.delete_view(view_id, undoes=True)
        except NotFound:
            return True
        except Conflict:
            return False
        return True

    def is_imported(self, view_id: str) -> bool:
        """Whether an import enrolled a view."""
        return self._jobs.is_imported(view_id)

    def report(self, claim: MapClaim, report: Report) -> None:
        """Tell the store how far a job is; raises LeaseLost."""
        self._jobs.report_import(claim, report.progress, asdict(report))

    def began(self, claim: MapClaim) -> datetime | None:
        """When a job was queued that has run before; None in its first run. Raises LeaseLost when it is gone."""
        try:
            job = self._jobs.get(claim.job_id)
        except NotFound as error:
            raise LeaseLost(error.detail) from None
        return None if job.progress is None else job.created_at  # which each run reports first of all


class _Run:
    """One run of a job: its images pass from being read over being stored to being described, in order."""

    def __init__(
        self,
        importer: Importer,
        claim: MapClaim,
        stopping: Callable[[], bool],
        report: Report,
        exif: frozenset[str],
        refuse_poor: bool,
        close: Callable[[], None],
    ) -> None:
        self._importer, self._claim, self._stopping, self._report = importer, claim, stopping, report
        self._exif, self._refuse_poor, self._close = exif, refuse_poor, close
        self._began = importer.began(claim)
        self._seen: set[str] = set()
        self._describing: deque[_Describing] = deque()
        self._told = 0.0

    def all(self, items: list[Item]) -> None:
        """Import the items, to the description of the last; raises JobStopped, LeaseLost, DiskFull, StorageFailed."""
        self._tell()
        with ThreadPoolExecutor(DECODED_AHEAD, "revisit-import") as threads:
            try:
                for item, reading in self._reading(items, threads):
                    self._import(item, reading)
                    while self._is_ahead():
                        self._await_oldest()
            except BaseException:
                threads.shutdown(wait=False, cancel_futures=True)
                self._close()  # or else the threads, which are waited for, go on to the next frame of a video
                raise
        while self._describing:
            self._await_oldest()

    def _reading(self, items: list[Item], threads: ThreadPoolExecutor) -> "Iterator[tuple[Item, Future[Any]]]":
        ahead: deque[tuple[Item, Future[Any]]] = deque()
        for item in items:
            ahead.append((item, threads.submit(self._importer.read, self._claim, item, self._exif, self._began)))
            if len(ahead) >= DECODED_AHEAD:
                yield ahead.popleft()
        yield from ahead

    def _import(self, item: Item, reading: "Future[Any]") -> None:
        self._tell()
        while not wait([reading], TOLD_EVERY_S).done:  # of a video, the next frame may be far
            self._tell()
        try:
            read = reading.result()
            view, created = read.view, False
            if view is None:
                if read.problem is not None and self._refuse_poor:
                    raise PoorImage(read.problem)
                one = self._importer.submit(self._claim, read.data, read.attributes, read.image, self._refuse_poor)
                view, created = one.view, one.created
        except (*STORAGE_ERRORS, LeaseLost, EncoderAway):
            raise
        except Repeated:
            self._report.already_there += 1
            return
        except RevisitError as error:
            self._fail(item.file, error.code, error.detail)
            return
        except ValueError as error:
            self._fail(item.file, "malformed-body", str(error))
            return
        # A run after a crash finds views that an earlier run of the same job enrolled.
        since = self._began is not None and not created and view.enrolled_at >= self._began
        earlier = since and self._importer.is_imported(view.id)
        own = (created or earlier) and view.id not in self._seen
        self._seen.add(view.id)
        size = 3 * view.image.width * view.image.height
        self._describing.append(_Describing(item.file, view.id, own, size, read.problem is not None))

    def _is_ahead(self) -> bool:
        """Whether enough is stored: the encoder is to catch up first."""
        count = len(self._describing)
        return count >= AHEAD or (
            count >= LEAST_AHEAD and sum(one.size for one in self._describing) > self._importer.ahead_bytes
        )

    def _await_oldest(self) -> None:
        file, view_id, own, _, poor = self._describing[0]
        view = self._importer.settled(view_id, TOLD_EVERY_S)
        self._tell()
        if view is not None and view.state == "pending":
            time.sleep(PAUSE_S)  # waiting may have been in vain, as while descriptions cannot be stored
            return
        self._describing.popleft()
        if view is None:
            self._fail(file, "not-found", f"its view {view_id} was deleted before it was described")
        elif view.state == "failed" and view.failure is not None:
            code, detail = view.failure
            # Refused, it leaves nothing where nobody was told of it.
            if not (own and code == PoorImage.code and self._importer.drop(view_id)):
                detail = f"{detail} ({KEPT.format(view_id)})"
            self._fail(file, code, detail)
        elif own:
            self._report.enrolled += 1
            self._report.poor += poor
        else:
            self._report.already_there += 1

    def _fail(self, file: str, problem: str, detail: str) -> None:
        self._report.failed += 1
        self._report.add(Note(file, problem, detail))

    def _tell(self) -> None:
        """Report progress now and then; raises JobStopped, LeaseLost."""
        if self._stopping():
            raise JobStopped
        if time.monotonic() - self._told >= TOLD_EVERY_S:
            self._importer.report(self._claim, self._report)
            self._told = time.monotonic()


class _Describing(NamedTuple):
    """A view that is being described: whether this import enrolled it, bytes of its pixels, and whether it is poor."""

    file: str
    view_id: str
    own: bool
    size: int
    poor: bool


@dataclass(frozen=True)
class _Read:
    """An image that was read, with its view in the map or else decoded; and what is wrong with it, in words.

    Images of views that were there before the job are not examined: `problem` is None.
    """

    data: bytes
    attributes: ViewAttributes
    view: ViewRecord | None
    image: Image | None
    problem: str | None


def _now() -> datetime:
    return datetime.now(UTC)
