"""Uploads of recordings: kept on disk from the first byte until their job ends.

``imports/JOB/upload`` is what was sent, ``imports/JOB/request.json`` what was asked; both are durable before the row of
the job is. What is being received lies in ``imports/.receiving-...``. A reader of an upload may store what it found out
beside the file; that is removed with it.

Where images lie in an object store, recordings lie there too, under the same names: any worker of the database finds
them. They are received and checked in the folder of one node first.
"""

import json
import logging
import os
import shutil
import uuid
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from schemas.errors import Damaged, RevisitError
from worker.storage.disk_errors import translated
from worker.storage.image_files import sync_folder
from worker.storage.scratch import Scratch
from worker.storage.space import Space

if TYPE_CHECKING:
    from worker.storage.object_files import ObjectFiles  # loads boto3, which a folder does not need

log = logging.getLogger("revisit")

IMPORTS = "imports"
"""Of the data folder, and below the prefix of an object store."""

RECEIVING = ".receiving-"
LOOK_EVERY_BYTES = 8_000_000


class Upload:
    """A file that is being received; `discard` or `Uploads.keep` ends it.

    Parameters
    ----------
    folder : Path
        Made for it.
    space : Space or None
    announced : int
        Bytes that the caller said will come; 0: unknown.

    Raises
    ------
    DiskFull, StorageFailed
    """

    def __init__(self, folder: Path, space: Space | None, announced: int) -> None:
        self.folder, self._space = folder, space
        self._received = self._looked_at = 0
        if space is not None:
            space.admit(announced)
        with translated("imports"):
            folder.mkdir(parents=True)
            self._file = self.path.open("xb")

    @property
    def path(self) -> Path:
        """Of the file."""
        return self.folder / "upload"

    def write(self, data: bytes) -> None:
        """Add bytes; raises DiskFull, StorageFailed."""
        if self._space is not None and self._received >= self._looked_at:
            self._space.admit(LOOK_EVERY_BYTES)
            self._looked_at = self._received + LOOK_EVERY_BYTES
        with translated("imports"):
            self._file.write(data)
        self._received += len(data)

    def end(self) -> None:
        """Make what was received durable; raises DiskFull, StorageFailed."""
        with translated("imports"):
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()

    def discard(self) -> None:
        """Remove it."""
        with suppress(OSError):  # what it still held did not fit on the disk
            self._file.close()
        shutil.rmtree(self.folder, ignore_errors=True)


class Uploads:
    """The folder of uploads.

    Parameters
    ----------
    folder : Path
    space : Space or None
    """

    def __init__(self, folder: Path, space: Space | None) -> None:
        self._folder, self._space = folder, space

    def receive(self, announced: int = 0) -> Upload:
        """Begin to receive a file; raises DiskFull, StorageFailed."""
        return Upload(self._folder / f"{RECEIVING}{uuid.uuid4().hex}", self._space, announced)

    def keep(self, upload: Upload, job_id: str, request: Mapping[str, Any]) -> None:
        """Keep a received file durably for a job; raises DiskFull, StorageFailed."""
        with translated("imports"):
            with (upload.folder / "request.json").open("x", encoding="utf-8") as file:
                json.dump(dict(request), file)
                file.flush()
                os.fsync(file.fileno())
            sync_folder(upload.folder)
            upload.folder.rename(self._folder / job_id)
            sync_folder(self._folder)
            sync_folder(self._folder.parent)

    @contextmanager
    def opened(self, job_id: str, on_progress: Callable[[], None]) -> Iterator[tuple[Path, dict[str, Any]]]:
        """The file of a job, which can be read during the block, and what was asked.

        Parameters
        ----------
        job_id : str
        on_progress : function
            Called now and then while a file is fetched; what it raises ends that.

        Raises
        ------
        FileNotFoundError, ValueError, Damaged, DiskFull, StorageFailed
        """
        folder = self._folder / job_id
        yield folder / "upload", _request((folder / "request.json").read_bytes(), job_id)

    def discard(self, job_id: str) -> None:
        """Remove the file of a job that has ended; does nothing when there is none."""
        shutil.rmtree(self._folder / job_id, ignore_errors=True)

    def sweep(self, needed: Collection[str]) -> None:
        """Remove all but the files of the jobs `needed`; only while nothing is being received."""
        if self._folder.is_dir():
            for folder in self._folder.iterdir():
                if folder.name not in needed:
                    shutil.rmtree(folder, ignore_errors=True)


def _request(body: bytes, job_id: str) -> dict[str, Any]:
    request = json.loads(body)
    if not isinstance(request, dict):
        raise ValueError(f"the request.json of the import {job_id} is no JSON object")
    return request


class SharedUploads(Uploads):
    """Uploads in an object store, under the folder's names; only what is being received lies in the folder.

    Parameters
    ----------
    folder : Path
    space : Space or None
    files : ObjectFiles
    scratch : Scratch
        Where a recording lies while it is imported.
    """

    def __init__(self, folder: Path, space: Space | None, files: "ObjectFiles", scratch: Scratch) -> None:
        super().__init__(folder, space)
        self._files, self._scratch = files, scratch

    def keep(self, upload: Upload, job_id: str, request: Mapping[str, Any]) -> None:
        """Keep a received file durably for a job; raises DiskFull, StorageFailed."""
        try:
            with translated(IMPORTS):
                digest = self._files.put(upload.path, _name(job_id))
            self._files.write(_name(job_id, "request.json"), json.dumps({**request, "sha256": digest}).encode())
        except BaseException:
            self.discard(job_id)
            raise

    @contextmanager
    def opened(self, job_id: str, on_progress: Callable[[], None]) -> Iterator[tuple[Path, dict[str, Any]]]:
        """As for a folder: the file is fetched for the block, if the disk has room for it."""
        request = _request(self._files.read(_name(job_id, "request.json")), job_id)
        digest = request.pop("sha256", None)

        def look(count: int) -> None:
            on_progress()
            if self._space is not None:
                self._space.admit(count)

        if self._space is not None:
            self._space.admit(self._files.size(_name(job_id)))
        with self._scratch.made() as own:
            path = own / "upload"
            with translated(IMPORTS):
                if self._files.fetch(_name(job_id), path, look) != digest:
                    where = f"{self._files.address}/{_name(job_id)}"
                    raise Damaged(f"the recording {where} does not hold what was sent; send it again")
            yield path, request

    def discard(self, job_id: str) -> None:
        """Remove the file of a job that has ended; one that the store keeps for now is swept later."""
        try:
            for name in ("request.json", "upload"):
                self._files.remove(_name(job_id, name))
        except RevisitError as error:
            log.warning("the recording of the import %s is not removed yet: %s", job_id, error.detail)


def _name(job_id: str, name: str = "upload") -> str:
    return f"{IMPORTS}/{job_id}/{name}"
