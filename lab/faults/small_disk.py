"""A small disk of its own for a data folder, which another program can fill."""

import errno
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class NotMounted(Exception):
    """This machine does not let the caller mount a file system; the text is what it said."""


@contextmanager
def small_disk(folder: Path, size_mb: int, inodes: int | None = None) -> Iterator[Path]:
    """Mount a file system in memory on an empty folder, and take it away at the end.

    Parameters
    ----------
    folder : Path
    size_mb : int
        Size in MiB.
    inodes : int or None
        Files and folders that it takes; None for as many as usual.

    Raises
    ------
    NotMounted
    """
    options = f"size={size_mb}m" + ("" if inodes is None else f",nr_inodes={inodes}")
    mount = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    made = subprocess.run(mount, capture_output=True, text=True)
    if made.returncode != 0:
        raise NotMounted(made.stderr.strip())
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def fill(disk: Path) -> Path:
    """Another program takes the space of a disk, to the last byte; removing its file gives the space back.

    Parameters
    ----------
    disk : Path
        Any folder of the file system.
    """
    hog = disk / "hog"
    with hog.open("wb") as file:
        while True:
            found = os.statvfs(disk)
            size = file.seek(0, os.SEEK_END) + found.f_bavail * found.f_frsize
            try:
                os.posix_fallocate(file.fileno(), 0, size)
                return hog
            except OSError as error:  # the service took some of it meanwhile
                if error.errno != errno.ENOSPC:
                    raise
