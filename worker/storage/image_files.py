"""Enrolled images as files, named by the SHA-256 of their bytes.

A file is durable before the row that needs it is committed, and is removed after the last such row. A crash in between
leaves a file without a row, which `sweep` removes, never a row without its file.

Files lie in ``ab/cd/abcd...``. Each first folder has a lock: a writer holds it until the row is committed, and a
remover holds it while it reads the rows, so that no file is removed between its writing and its row.
"""

import hashlib
import os
import re
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from schemas.errors import Damaged, RevisitError
from worker.storage import owner_file, whole_files
from worker.storage.disk_errors import translated
from worker.storage.locks import held
from worker.storage.owner_file import OWNER
from worker.storage.peers import ImageHold

UNFINISHED = ".writing-"

LOCK = ".lock"
"""Of each of the 256 folders of images."""

DIGEST = re.compile("[0-9a-f]{64}")

LOST = "the file {} of its image {}; enrol the image again, or restore the file from a backup"

SYNCS = 16
"""Files whose bytes are waited for at a time: the disk serves them together."""

Owned = Callable[[list[str]], set[str]]
"""From digests to those that some view still needs."""


class Discarded(NamedTuple):
    """What became of images that views gave up: how many were removed, and those that other views still need.

    Both are as it was when their removal was decided, and nobody could add a view of them.
    """

    removed: int
    needed: frozenset[str]


def damaged_or(read: Callable[[str], bytes], digest: str) -> bytes | Damaged:
    """The bytes that `read` gives for an image, or the Damaged that it raises."""
    try:
        return read(digest)
    except Damaged as error:
        return error


def sync_folder(folder: Path) -> None:
    """Make the entries of a folder durable."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def owner_of(folder: Path) -> str | None:
    """The id of the database that the images of a folder belong to; None where that is not recorded."""
    with suppress(FileNotFoundError):
        return owner_file.read((folder / OWNER).read_bytes())
    return None


class Images:
    """The folder of images.

    Parameters
    ----------
    folder : Path
        Created when there is none.
    owned : function
        Reads from the database which digests views still need.
    """

    files = prompt = None
    """Recordings and snapshots have folders of their own."""

    def __init__(self, folder: Path, owned: Owned) -> None:
        self._folder = folder
        self._owned = owned
        self._left: set[str] = set()
        self._synced: set[str] = set()  # first two digits whose folder is durable
        folder.mkdir(parents=True, exist_ok=True)

    @contextmanager
    def kept(self, digest: str, image: bytes) -> Iterator[ImageHold]:
        """Write an image durably, then run a block that commits a row with its digest.

        When the block raises, the file is removed unless a view needs it.

        Raises
        ------
        ValueError
            The digest is not that of the image.
        DiskFull
        """
        if hashlib.sha256(image).hexdigest() != digest:
            raise ValueError(f"{digest} is not the SHA-256 of the image")
        with self._locked(digest[:2]):
            written = self._write(digest, image)
            try:
                yield ImageHold()
            except BaseException:
                if written:
                    self._left.add(digest)
                    with suppress(RevisitError):  # then it goes later, and what was raised before is told
                        self._discard([digest])
                        self._left.discard(digest)
                raise

    def add(self, images: Mapping[str, bytes]) -> None:
        """Write images durably, by their digests, after `await_removals`; their rows are committed already.

        Raises
        ------
        DiskFull
        """
        written: list[tuple[Path, Path, int]] = []
        with translated("images"), ThreadPoolExecutor(SYNCS, "revisit-sync") as pool, ExitStack() as stack:
            for digest, image in images.items():
                path = self._path(digest)
                path.parent.mkdir(parents=True, exist_ok=True)
                unfinished = path.parent.parent / f"{UNFINISHED}{uuid.uuid4().hex}"
                stack.callback(unfinished.unlink, missing_ok=True)
                file = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
                stack.callback(os.close, file)
                written.append((unfinished, path, file))
                whole_files.write(file, image)
            os.sync()  # for all at once; then each of them is quick, and reports its own errors
            list(pool.map(os.fsync, [file for _, _, file in written]))
            for unfinished, path, _ in written:
                unfinished.rename(path)
            os.sync()
            list(pool.map(sync_folder, {at for _, path, _ in written for at in (path.parent, path.parent.parent)}))
            sync_folder(self._folder)

    def await_removals(self) -> None:
        """Wait for removals that may have begun before the rows which are committed now."""
        for folder in self._folder.glob("[0-9a-f][0-9a-f]"):
            with self._locked(folder.name):
                pass

    def read(self, digest: str) -> bytes:
        """The bytes of an image.

        Raises
        ------
        Damaged
            The file is missing, cannot be read, or does not hold these bytes.
        """
        if not DIGEST.fullmatch(digest):
            raise Damaged(f"the stored SHA-256 of its image, {digest!r}, is none; enrol the image again")
        try:
            image = whole_files.read(f"{self._folder}/{digest[:2]}/{digest[2:4]}/{digest}")  # a `Path` takes longer
        except FileNotFoundError:
            raise self._lost(digest, "is missing") from None
        except OSError as error:
            raise self._lost(digest, f"cannot be read ({error.strerror})") from error
        if hashlib.sha256(image).hexdigest() != digest:
            raise self._lost(digest, "does not hold what was enrolled" if image else "is empty")
        return image

    def read_each(self, digests: Sequence[str]) -> list[bytes | Damaged]:
        """The bytes of each image, or the Damaged that `read` would raise."""
        return [damaged_or(self.read, digest) for digest in digests]

    def _lost(self, digest: str, how: str) -> Damaged:
        return Damaged(LOST.format(self._path(digest).relative_to(self._folder.parent), how))

    def discard(self, digests: Iterable[str]) -> Discarded:
        """Remove images that no view needs, after their rows were deleted; those that cannot be now are in `left`.

        What is no digest comes from a damaged row and names no image; as a path it could be that of any file.
        """
        removed, needed = 0, set[str]()
        waiting = {digest for digest in digests if DIGEST.fullmatch(digest)}
        try:
            for first, group in groupby(sorted(waiting), key=lambda digest: digest[:2]):
                few = list(group)
                with self._locked(first):
                    some = self._discard(few)
                waiting.difference_update(few)
                self._left.difference_update(few)
                removed += some.removed
                needed |= some.needed
        finally:  # none before that: who removes what is left would take it from this call, which counts it
            self._left.update(waiting)
        return Discarded(removed, frozenset(needed))

    @property
    def left(self) -> frozenset[str]:
        """Digests of images that `discard` could not remove yet, since the database did not say who needs them."""
        return frozenset(self._left)

    def sweep(self) -> int:
        """Remove unfinished files and images without a view, which a crash left; returns how many."""
        removed = 0
        for folder in sorted(self._folder.glob("[0-9a-f][0-9a-f]")):
            with self._locked(folder.name):  # whoever wrote here has finished or died
                for unfinished in folder.glob(UNFINISHED + "*"):
                    unfinished.unlink()
                    removed += 1
                names = (path.name for path in folder.glob("[0-9a-f][0-9a-f]/*"))
                removed += self._discard([name for name in names if DIGEST.fullmatch(name)]).removed
        return removed

    def sweep_at_start(self) -> None:
        """`sweep`: its locks keep it from what others write."""
        self.sweep()

    @property
    def owner_name(self) -> str:
        """Path of the file that `owner` reads."""
        return str(self._folder / OWNER)

    def owner(self) -> str | None:
        """The id of the database that the images belong to; None where that is not recorded. Raises StorageFailed."""
        with translated("images"):
            return owner_of(self._folder)

    def claim(self, owner: str) -> None:
        """Record, durably, which database the images belong to; raises DiskFull, StorageFailed."""
        unfinished = self._folder / f"{UNFINISHED}{OWNER}"
        with translated("images"):
            with unfinished.open("wb") as file:
                file.write(owner_file.written(owner))
                file.flush()
                os.fsync(file.fileno())
            unfinished.rename(self._folder / OWNER)
            sync_folder(self._folder)

    def holds_any(self) -> bool:
        """Whether there is an image, of a view or not."""
        return any(self._folder.glob("[0-9a-f][0-9a-f]/[0-9a-f][0-9a-f]/*"))

    def problem(self) -> str | None:
        """Why images cannot be read or written now, or None."""
        if os.access(self._folder, os.R_OK | os.W_OK | os.X_OK):
            return None
        return f"the folder {self._folder} is missing or cannot be written"

    def close(self) -> None:
        """Does nothing: no file is kept open."""

    def _path(self, digest: str) -> Path:
        if not DIGEST.fullmatch(digest):
            raise ValueError(f"{digest!r} is no SHA-256")
        return self._folder / f"{digest[:2]}/{digest[2:4]}/{digest}"

    @contextmanager
    def _locked(self, first: str) -> Iterator[None]:
        with translated("images"), held(self._folder / first / LOCK):
            yield

    def _write(self, digest: str, image: bytes) -> bool:
        """Write an image unless its file exists; returns whether it was written."""
        path = self._path(digest)
        # A file is renamed after its bytes are durable; but one may have been damaged since.
        if path.is_file() and path.stat().st_size == len(image) and path.read_bytes() == image:
            self._sync_name(path)  # its writer may have died before this
            return False
        unfinished = path.parent.parent / f"{UNFINISHED}{uuid.uuid4().hex}"
        try:
            path.parent.mkdir(exist_ok=True)
            with unfinished.open("xb") as file:
                file.write(image)
                file.flush()
                os.fsync(file.fileno())
            unfinished.rename(path)
            self._sync_name(path)
        except BaseException:
            unfinished.unlink(missing_ok=True)
            path.unlink(missing_ok=True)
            raise
        return True

    def _sync_name(self, path: Path) -> None:
        """Make the entries of a file and of its folders, which may be new, durable."""
        sync_folder(path.parent)
        first = path.parent.parent
        sync_folder(first)
        if first.name not in self._synced:  # once by each process: it may be of one that died before this
            sync_folder(self._folder)
            self._synced.add(first.name)

    def _discard(self, digests: list[str]) -> Discarded:
        removed, needed = 0, self._owned(digests)
        for digest in sorted(set(digests) - needed):
            path = self._path(digest)
            if path.is_file():
                path.unlink()
                removed += 1
        return Discarded(removed, frozenset(needed))
