"""Calls about work in the background: jobs, and the imports that begin one."""

import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from pydantic import ValidationError

from revisit_client import wire
from revisit_client.connection import GATEWAY, Connection
from revisit_client.errors import JobFailed, RevisitProblem, Unreachable
from revisit_client.parameters import address, texts
from revisit_client.recordings import Body, folder_as_zip, pieces_of

SILENCE_S = 20.0
"""Seconds without a sign of life after which events count as lost; the service sends one every 5."""

POLLED_INSTEAD = frozenset({404, 405, 429, 503, *GATEWAY})
"""Refusals of events after which the job is asked for: an older service, a busy one, one that a gateway does not reach,
or no such job any more."""


class JobCalls:
    """The calls of a client about jobs."""

    _connection: Connection
    _clock: Callable[[], float]
    _sleep: Callable[[float], None]

    def import_recording(
        self,
        source: bytes | str | os.PathLike[str],
        *,
        map: str,
        manifest: str | os.PathLike[str] | None = None,
        exif: bool = False,
        panorama: bool = False,
        refuse_poor: bool | None = None,
        every: str | None = None,
        image_topic: str | None = None,
        pose_topic: str | None = None,
    ) -> wire.Job:
        """Send a recording, whose images are then enrolled by the job that is returned; see `wait_for_job`.

        The job's `result` counts the images and lists the errors of single ones.

        Parameters
        ----------
        source : bytes or path
            A zip archive of images, or a folder, of which the images and manifests are sent. A file ``manifest.csv`` or
            ``manifest.ndjson`` says what is known of the images. Or a video: MP4, QuickTime, Matroska, WebM, AVI. Or a
            recording of ROS 2 (MCAP), if the service reads them.
        map : str
            Made when there is none.
        manifest : path or None
            Sent as the manifest of a folder that holds none.
        exif : bool
            Take place and time from the EXIF of images where the manifest says nothing of them; refused with a video.
        panorama : bool
            Every image is an equirectangular panorama, and is enrolled as eight views.
        refuse_poor : bool or None
            Leave out images that are dark, overexposed, covered or blurred, show mostly what moves or are nearly in the
            map already, as errors of their own. None: as the map says.
        every : str or None
            Least time (``2s``, ``1min``) or way (``1m``: metres) from one image to the next. None: all images, and of
            a video one a second.
        image_topic, pose_topic : str or None
            Of a ROS 2 recording with several.
        """
        body: bytes | Body
        headers = {"content-type": "application/octet-stream"}
        if not isinstance(source, bytes) and Path(source).is_dir():
            packed = partial(folder_as_zip, Path(source), None if manifest is None else Path(manifest))
            packed()  # what cannot be packed is told before anything is sent
            body = Body(packed)
        elif manifest is not None:
            raise ValueError("a manifest goes with a folder; that of an archive lies in it")
        elif isinstance(source, bytes):
            body = source
        else:
            headers["content-length"] = str(
                Path(source).stat().st_size
            )  # what is too large is refused before it is sent
            body = Body(partial(pieces_of, Path(source)))
        return self._connection.receive(
            wire.Job,
            "POST",
            address("maps", map, "imports"),
            params=texts(
                {
                    "exif": exif or None,
                    "panorama": panorama or None,
                    "refuse_poor": refuse_poor,
                    "every": every,
                    "image_topic": image_topic,
                    "pose_topic": pose_topic,
                }
            ),
            content=body,
            headers=headers,
            timeout=self._connection.until_stored,
            repeat=False,
        )

    def job(self, job_id: str) -> wire.Job:
        """One job."""
        return self._connection.receive(wire.Job, "GET", address("jobs", job_id))

    def jobs(self, map: str | None = None, *, kind: str | None = None, state: str | None = None) -> Iterator[wire.Job]:
        """Iterate over jobs, newest first, fetched in pages as needed; `kind`: one, or several with commas between."""
        for page in self._connection.pages(wire.Jobs, "/jobs", texts({"map": map, "kind": kind, "state": state})):
            yield from page.jobs

    def cancel_job(self, job_id: str) -> wire.Job:
        """Cancel a describe job that is waiting, or a job of another kind that has not finished."""
        return self._connection.receive(wire.Job, "DELETE", address("jobs", job_id))

    def wait_for_job(
        self, job_id: str, *, timeout: float = 600.0, follow: Callable[[wire.Job], None] = lambda job: None
    ) -> wire.Job:
        """Wait until a job is done, at most `timeout` seconds; `follow` is called with each state of it on the way.

        Raises
        ------
        JobFailed
            The job failed or was cancelled.
        TimeoutError
            The job is still waiting or running.
        """
        deadline = self._clock() + timeout
        states = self._states(job_id, deadline)
        while True:
            job = next(states)
            follow(job)
            if job.state == "done":
                return job
            if job.state in ("failed", "cancelled"):
                raise JobFailed(job)
            if self._clock() >= deadline:
                raise TimeoutError(f"job {job_id} is still {job.state} after {timeout:g} s")

    def _states(self, job_id: str, deadline: float) -> Iterator[wire.Job]:
        """The job without end: sent by the service as it changes, asked for where no events come through."""
        pause = 0.05
        while True:
            job = self._connection.receive(wire.Job, "GET", address("jobs", job_id))
            yield job
            silence = max(0.1, min(SILENCE_S, deadline - self._clock()))
            try:
                for now in self._connection.events(wire.Job, address("jobs", job_id, "events"), silence):
                    job = now or job
                    yield job
            except RevisitProblem as problem:
                if problem.status not in POLLED_INSTEAD:
                    raise
            except (Unreachable, ValidationError):
                pass  # a proxy may cut streams: asking shows whether the service is away
            self._sleep(min(pause, max(0.0, deadline - self._clock())))
            pause = min(1.0, pause * 1.5)
