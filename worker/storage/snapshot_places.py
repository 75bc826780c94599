"""Where snapshots are kept: in a folder, or in an object store, where any node of a fleet finds them."""

import uuid
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Protocol

from schemas.errors import BadSnapshot
from schemas.snapshot import SnapshotFacts
from worker.storage.image_files import sync_folder
from worker.storage.scratch import Scratch
from worker.storage.snapshot_files import SnapshotReader

if TYPE_CHECKING:
    from worker.storage.object_files import ObjectFiles  # loads boto3, which a folder does not need

SNAPSHOTS = "snapshots"
"""Of the data folder, and below the prefix of an object store."""

SUFFIX = ".snapshot"
WRITING = ".writing-"

DIGESTS = ".digests"
"""Of the file beside a snapshot in an object store: SHA-256 of the images of its views, 32 bytes each."""


class SnapshotPlace(Protocol):
    """Files of snapshots by their ids. Methods that read one raise FileNotFoundError where there is none."""

    def draft(self, snapshot_id: str) -> AbstractContextManager[Path]:
        """A path to write a new one to, on this machine; removed at the end of the block unless it was kept."""
        ...

    def keep(self, draft: Path, snapshot_id: str, on_progress: Callable[[], None]) -> None:
        """Keep a written draft durably, in place of any earlier file of this id.

        `on_progress` is called now and then while the file is sent; what it raises ends the sending.
        """
        ...

    def ids(self) -> list[str]:
        """The ids of all snapshots that are kept."""
        ...

    def facts(self, snapshot_id: str) -> tuple[SnapshotFacts, int]:
        """What a snapshot is, and the size of its file in bytes; raises BadSnapshot."""
        ...

    def stamp(self, snapshot_id: str) -> tuple[int, ...]:
        """Numbers that change when its file does."""
        ...

    def digests(self, snapshot_id: str) -> frozenset[bytes]:
        """SHA-256 of the images of all views of a snapshot; raises BadSnapshot."""
        ...

    def open(self, snapshot_id: str) -> BinaryIO:
        """The file of a snapshot, for reading."""
        ...

    def remove(self, snapshot_id: str) -> None:
        """Remove the file of a snapshot."""
        ...


def drop_drafts(folder: Path, snapshot_id: str) -> None:
    """Remove what was written of a snapshot that is not kept."""
    for path in folder.glob(f"{WRITING}{snapshot_id}*"):
        path.unlink(missing_ok=True)


class SnapshotFolder:
    """Snapshots in a folder, which is made with the first of them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @contextmanager
    def draft(self, snapshot_id: str) -> Iterator[Path]:
        """A path to write a new one to."""
        self._folder.mkdir(exist_ok=True)
        # What a worker left that died; or one that stood still, and must not go on writing to this one's file.
        drop_drafts(self._folder, snapshot_id)
        path = self._folder / f"{WRITING}{snapshot_id}.{uuid.uuid4().hex}"
        try:
            yield path
        finally:
            path.unlink(missing_ok=True)

    def keep(self, draft: Path, snapshot_id: str, on_progress: Callable[[], None]) -> None:
        """Keep one that was written."""
        draft.rename(self._path(snapshot_id))
        sync_folder(self._folder)

    def ids(self) -> list[str]:
        """Of all that are kept."""
        return [path.name.removesuffix(SUFFIX) for path in self._folder.glob(f"*{SUFFIX}")]

    def facts(self, snapshot_id: str) -> tuple[SnapshotFacts, int]:
        """What one is, and its bytes."""
        path = self._path(snapshot_id)
        return SnapshotReader(path).facts(), path.stat().st_size

    def stamp(self, snapshot_id: str) -> tuple[int, ...]:
        """Numbers that change when its file does."""
        stat = self._path(snapshot_id).stat()
        return stat.st_size, stat.st_mtime_ns

    def digests(self, snapshot_id: str) -> frozenset[bytes]:
        """SHA-256 of the images of its views."""
        return SnapshotReader(self._path(snapshot_id)).digests()

    def open(self, snapshot_id: str) -> BinaryIO:
        """Its file, for reading."""
        return self._path(snapshot_id).open("rb")

    def remove(self, snapshot_id: str) -> None:
        """Remove one."""
        self._path(snapshot_id).unlink()
        sync_folder(self._folder)

    def _path(self, snapshot_id: str) -> Path:
        return self._folder / f"{snapshot_id}{SUFFIX}"


class SnapshotObjects:
    """Snapshots in an object store; each is written in a scratch folder of the worker that makes it."""

    def __init__(self, files: "ObjectFiles", scratch: Scratch) -> None:
        self._files, self._scratch = files, scratch

    @contextmanager
    def draft(self, snapshot_id: str) -> Iterator[Path]:
        """A path to write a new one to."""
        with self._scratch.made() as own:
            yield own / snapshot_id

    def keep(self, draft: Path, snapshot_id: str, on_progress: Callable[[], None]) -> None:
        """Keep one that was written."""
        # First what only belongs to a snapshot: without one, `worker.storage.leftovers` removes it.
        self._files.write(_name(snapshot_id, DIGESTS), b"".join(sorted(SnapshotReader(draft).digests())))
        self._files.put(draft, _name(snapshot_id), on_progress)

    def ids(self) -> list[str]:
        """Of all that are kept."""
        names = [one.name.removeprefix(f"{SNAPSHOTS}/") for one in self._files.below(SNAPSHOTS)]
        return [name.removesuffix(SUFFIX) for name in names if name.endswith(SUFFIX)]

    def facts(self, snapshot_id: str) -> tuple[SnapshotFacts, int]:
        """What one is, and its bytes."""
        name = _name(snapshot_id)
        return SnapshotReader(_Source(self._files, name)).facts(), self._files.size(name)

    def stamp(self, snapshot_id: str) -> tuple[int, ...]:
        """Numbers that change when its file does."""
        return (self._files.size(_name(snapshot_id)),)  # it is written once, before its job ends

    def digests(self, snapshot_id: str) -> frozenset[bytes]:
        """SHA-256 of the images of its views."""
        try:
            body = self._files.read(_name(snapshot_id, DIGESTS))
        except FileNotFoundError:
            self._files.size(_name(snapshot_id))  # if that is gone too, so is the snapshot
            raise BadSnapshot(f"the file {DIGESTS} beside it is missing") from None
        return frozenset(body[at : at + 32] for at in range(0, len(body), 32))

    def open(self, snapshot_id: str) -> BinaryIO:
        """Its file, for reading."""
        return self._files.open(_name(snapshot_id))

    def remove(self, snapshot_id: str) -> None:
        """Remove one."""
        self._files.size(_name(snapshot_id))
        self._files.remove(_name(snapshot_id))
        self._files.remove(_name(snapshot_id, DIGESTS))


class _Source:
    """A file of a store as something that can be opened."""

    def __init__(self, files: "ObjectFiles", name: str) -> None:
        self._files, self._name = files, name

    def open(self, mode: str) -> BinaryIO:
        """Its file, for reading."""
        return self._files.open(self._name)


def _name(snapshot_id: str, suffix: str = SUFFIX) -> str:
    return f"{SNAPSHOTS}/{snapshot_id}{suffix}"
