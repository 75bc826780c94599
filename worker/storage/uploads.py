"""Uploads of recordings: kept on disk from the first byte until their job ends.

``imports/JOB/upload`` is what was sent, ``imports/JOB/request.json`` what was asked; both are durable before the row of
the job is. What is being received lies in ``imports/.receiving-...``. Who reads an upload may keep what it learned
beside it: that is removed with it.
"""

import json
import os
import shutil
import uuid
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from worker.storage.disk_errors import translated
from worker.storage.image_files import sync_folder
from worker.storage.space import Space

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

    def find(self, job_id: str) -> tuple[Path, dict[str, Any]]:
        """The file of a job and what was asked; raises FileNotFoundError, ValueError."""
        folder = self._folder / job_id
        request = json.loads((folder / "request.json").read_text(encoding="utf-8"))
        if not isinstance(request, dict):
            raise ValueError(f"{folder / 'request.json'} is no JSON object")
        return folder / "upload", request

    def discard(self, job_id: str) -> None:
        """Remove the file of a job that has ended; does nothing when there is none."""
        shutil.rmtree(self._folder / job_id, ignore_errors=True)

    def sweep(self, needed: Collection[str]) -> None:
        """Remove all but the files of the jobs `needed`; only while nothing is being received."""
        if self._folder.is_dir():
            for folder in self._folder.iterdir():
                if folder.name not in needed:
                    shutil.rmtree(folder, ignore_errors=True)
