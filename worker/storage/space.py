"""Space on the disk: a reserve for deletions, and a floor below which nothing more is enrolled.

A deletion needs space before it frees any: the database writes a journal first. A file holds that space, where other
programs cannot take it, and is given up when a deletion finds the disk full. It is made again once there is room.
"""

import errno
import logging
import os
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from schemas.errors import DiskFull

log = logging.getLogger("revisit")

RESERVE = "reserve"
"""Name of the reserve file."""

LEAST_INODES = 100
"""Files that can still be made on a file system, below which nothing more is enrolled: each image is one, mostly in a
folder of its own, and the database needs some at each start."""

_MEGA = 1_000_000
_UNFINISHED = ".reserve-"
_PROBE_BYTES = 65536


class Space:
    """The space of the file systems that hold the images and the database.

    Parameters
    ----------
    folders : sequence of Path
        Each on the file system of the images or of the database; one of a file system counts.
    reserve_bytes : int
        Size of the reserve, and of the space beside it below which enrolments are refused; 0 for neither, and for no
        least number of inodes.
    """

    def __init__(self, folders: Sequence[Path], reserve_bytes: int) -> None:
        self._folders = list({os.stat(folder).st_dev: folder for folder in reversed(folders)}.values())
        self._reserve = reserve_bytes
        self._refused = 0  # size of the largest image for which there was no room, until there is

    def admit(self, size: int, *, image: bool = False) -> None:
        """Raise DiskFull unless `size` bytes may be added.

        While there is no room for an `image`, `problem` says so: nothing can be enrolled. Any other file that is
        refused, such as a snapshot to restore, may be so large that enrolments still fit.
        """
        for folder in self._folders:
            if self._reserve and self._available(folder) < 2 * self._reserve + size:
                if image:
                    self._refused = max(self._refused, size)
                raise DiskFull(self._full(folder, size))
            if (lacking := self._lacking_inodes(folder)) is not None:
                raise DiskFull(lacking)

    def require(self) -> None:
        """Raise DiskFull while the reserve is given up and there is no room to make it again."""
        for folder in self._folders:
            if self._reserve and self._available(folder) < self._reserve:
                raise DiskFull(self._full(folder))

    def problem(self) -> str | None:
        """What is wrong with the space, or None."""
        for folder in self._folders:
            if os.statvfs(folder).f_flag & os.ST_RDONLY:
                return f"the disk of {folder} is read-only; queries work, nothing can be stored until that changes"
            if self._reserve and self._available(folder) < 2 * self._reserve + self._refused:
                return self._full(folder, self._refused)
            if (lacking := self._lacking_inodes(folder)) is not None:
                return lacking
        self._refused = 0
        return None

    def refused(self) -> bool:
        """Whether nothing more can be written: the disk is full, or a quota used up, which free space does not show."""
        return any(_refuses(folder) for folder in self._folders)

    def inodes(self) -> int | None:
        """How many files can still be made, by the file system that takes fewest; None where none has such a limit."""
        limits = [left for folder in self._folders if (left := free_inodes(folder)) is not None]
        return min(limits, default=None)

    def give_up(self) -> bool:
        """Remove the reserve; returns whether there was one."""
        gone = False
        for folder in self._folders:
            with suppress(OSError):
                (folder / RESERVE).unlink()
                gone = True
        if gone:
            log.warning(
                "the disk is full: the reserve was given up for a deletion", extra={"event": "reserve_given_up"}
            )
        return gone

    def restore(self) -> None:
        """Make the reserve where there is none and there is room; quietly leaves it when that fails."""
        for folder in self._folders:
            there = self._kept(folder)
            if there != self._reserve and self._available(folder) >= 1.25 * self._reserve:
                self._make(folder)

    def low(self) -> bool:
        """Whether a reserve is given up or the space is below the floor of enrolments."""
        return bool(self._reserve) and any(
            self._kept(folder) < self._reserve or self._available(folder) < 2 * self._reserve
            for folder in self._folders
        )

    def _make(self, folder: Path) -> None:
        unfinished = folder / f"{_UNFINISHED}{os.getpid()}"
        try:
            (folder / RESERVE).unlink(missing_ok=True)  # of another size
            if self._reserve:
                file = os.open(unfinished, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600)
                try:
                    os.posix_fallocate(file, 0, self._reserve)
                finally:
                    os.close(file)
                unfinished.rename(folder / RESERVE)
        except OSError as error:
            with suppress(OSError):
                unfinished.unlink(missing_ok=True)
            log.debug("no reserve could be made in %s: %s", folder, error)

    def _available(self, folder: Path) -> int:
        """Free bytes, the reserve included."""
        found = os.statvfs(folder)
        return found.f_bavail * found.f_frsize + self._kept(folder)

    @staticmethod
    def _kept(folder: Path) -> int:
        try:
            return (folder / RESERVE).stat().st_size
        except OSError:
            return 0

    def _full(self, folder: Path, size: int = 0) -> str:
        free, kept = self._available(folder) / _MEGA, 2 * self._reserve / _MEGA
        lacks = f"has no room for {size / _MEGA:.1f} MB more" if free >= kept + 1 else "is full"
        return (
            f"the disk of {folder} {lacks}: {free:.1f} MB are left, {kept:.1f} MB are kept (REVISIT_RESERVE_MB) so "
            "that queries and deletions work; free some space or delete views"
        )

    def _lacking_inodes(self, folder: Path) -> str | None:
        left = free_inodes(folder) if self._reserve else None
        if left is None or left >= LEAST_INODES:
            return None
        return (
            f"the disk of {folder} takes few further files: {left} inodes are left (`df -i`), {LEAST_INODES} are kept "
            "so that queries and deletions work; delete views or other files"
        )


def free_inodes(folder: Path) -> int | None:
    """How many files can still be made on the file system of a folder; None where it has no such limit."""
    found = os.statvfs(folder)
    # Some file systems of other machines have a total and always say that nothing of it is left.
    if found.f_files == 0 or (found.f_favail == 0 and not _refuses(folder)):
        return None
    return found.f_favail


def _refuses(folder: Path) -> bool:
    try:
        with tempfile.TemporaryFile(dir=folder, buffering=0) as file:
            file.write(bytes(_PROBE_BYTES))
            os.fsync(file.fileno())
    except OSError as error:
        return error.errno in (errno.ENOSPC, errno.EDQUOT)
    return False
