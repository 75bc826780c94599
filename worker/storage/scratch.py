"""Scratch folders: files of one process for as long as it works on them, in its data folder."""

import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from worker.storage.disk_errors import translated
from worker.storage.locks import FolderLock, held

_MAKING, _USED = ".making", ".used"


class Scratch:
    """Makes scratch folders.

    A folder is locked while it is used, so that `sweep` knows those of processes that ended, however they ended.

    Parameters
    ----------
    folder : Path
        Made with the first of them.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @contextmanager
    def made(self) -> Iterator[Path]:
        """A new folder, which is removed at the end of the block."""
        own = self._folder / uuid.uuid4().hex
        with translated("scratch files"), held(self._folder / _MAKING):
            own.mkdir()
            used = FolderLock(own / _USED)
            used.acquire()
        try:
            yield own
        finally:
            shutil.rmtree(own, ignore_errors=True)
            used.release()

    def sweep(self) -> None:
        """Remove the folders that no process uses any longer."""
        if not self._folder.is_dir():
            return
        with translated("scratch files"), held(self._folder / _MAKING):
            for left in self._folder.iterdir():
                if left.name == _MAKING:
                    continue
                used = FolderLock(left / _USED)
                if used.acquire():
                    shutil.rmtree(left, ignore_errors=True)
                used.release()
