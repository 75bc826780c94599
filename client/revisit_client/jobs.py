"""Calls about work in the background: jobs, and the imports that begin one."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

from pydantic import ValidationError

from revisit_client import wire
from revisit_client.connection import Connection
from revisit_client.errors import JobFailed, RevisitProblem, Unreachable
from revisit_client.parameters import texts
from revisit_client.recordings import folder_as_zip, pieces_of

SILENCE_S = 20.0
"""Seconds without a sign of life after which events count as lost; the service sends one every 5."""


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
    ) -> wire.Job:
        """Send a recording, whose images are then enrolled by the job that is returned; see `wait_for_job`.

        The job's `result` counts the images and lists the errors of single ones.

        Parameters
        ----------
        source : bytes or path
            A zip archive of images, or a folder, of which the images and manifests are sent. A file ``manifest.csv`` or
            ``manifest.ndjson`` says what is known of the images.
        map : str
            Made when there is none.
        manifest : path or None
            Sent as the manifest of a folder that holds none.
        """
        body: bytes | Iterator[bytes]
        headers = {"content-type": "application/zip"}
        if not isinstance(source, bytes) and Path(source).is_dir():
            body = folder_as_zip(Path(source), None if manifest is None else Path(manifest))
        elif manifest is not None:
            raise ValueError("a manifest goes with a folder; that of an archive lies in it")
        elif isinstance(source, bytes):
            body = source
        else:
            headers["content-length"] = str(
                Path(source).stat().st_size
            )  # what is too large is refused before it is sent
            body = pieces_of(Path(source))
        return self._connection.receive(
            wire.Job,
            "POST",
            f"/maps/{map}/imports",
            content=body,
            headers=headers,
            repeat=False,
            once=not isinstance(body, bytes),
        )

    def job(self, job_id: str) -> wire.Job:
        """One job."""
        return self._connection.receive(wire.Job, "GET", f"/jobs/{job_id}")

    def jobs(self, map: str | None = None, *, kind: str | None = None, state: str | None = None) -> Iterator[wire.Job]:
        """Iterate over jobs, newest first, fetched in pages as needed."""
        for page in self._connection.pages(wire.Jobs, "/jobs", texts({"map": map, "kind": kind, "state": state})):
            yield from page.jobs

    def cancel_job(self, job_id: str) -> wire.Job:
        """Cancel a describe job that is waiting, or a recipe, vocabulary or import job that has not finished."""
        return self._connection.receive(wire.Job, "DELETE", f"/jobs/{job_id}")

    def wait_for_progress(self, job: wire.Job, *, patience: float = 10.0) -> wire.Job:
        """The job once its state or progress is another, or as it is after `patience` seconds."""
        deadline, pause = self._clock() + patience, 0.05
        while True:
            now = self.job(job.id)
            if (now.state, now.progress) != (job.state, job.progress) or self._clock() + pause > deadline:
                return now
            self._sleep(pause)
            pause = min(0.5, pause * 1.5)

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
        for job in self._states(job_id, deadline := self._clock() + timeout):
            follow(job)
            if job.state == "done":
                return job
            if job.state in ("failed", "cancelled"):
                raise JobFailed(job)
            if self._clock() > deadline:
                raise TimeoutError(f"job {job_id} is still {job.state} after {timeout:g} s")
        raise AssertionError("the states of a job end when it has ended")

    def _states(self, job_id: str, deadline: float) -> Iterator[wire.Job]:
        """States of a job, sent by the service as they change; asked for where events do not come through."""
        job = self.job(job_id)
        yield job
        pause = 0.05
        while True:
            silence = max(0.1, min(SILENCE_S, deadline - self._clock()))
            try:
                for now in self._connection.events(wire.Job, f"/jobs/{job_id}/events", silence):
                    job = job if now is None else now
                    yield job
            except RevisitProblem as problem:
                if problem.status not in (404, 405):  # an older service; that the job is gone, asking shows
                    raise
            except (Unreachable, ValidationError):
                pass  # a proxy may cut streams; asking shows whether the service is away
            self._sleep(pause)
            pause = min(1.0, pause * 1.5)
            job = self.job(job_id)
            yield job
