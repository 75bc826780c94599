"""A disk of ext4 in a file, on which the kernel finds an error, or whose power is cut."""

import fcntl
import os
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lab.faults.small_disk import NotMounted

SIZE = 96_000_000
"""Bytes."""

SHUTDOWN, WITHOUT_LOG = 0x8004587D, 2
"""EXT4_IOC_SHUTDOWN, and its flag that leaves the journal as it is on the disk (fs/ext4/ext4.h)."""


class Ext4Disk:
    """A mounted disk.

    Parameters
    ----------
    folder : Path
        For the file, and for `at`, where the disk is mounted.

    Raises
    ------
    NotMounted
    """

    def __init__(self, folder: Path) -> None:
        self.at = folder / "disk"
        self._file = folder / "disk.ext4"
        self.at.mkdir(parents=True)
        with self._file.open("wb") as file:
            file.truncate(SIZE)
        try:
            _run("mkfs.ext4", "-q", "-F", "-m", "0", str(self._file))
            self._mount()
        except (OSError, subprocess.CalledProcessError) as error:
            raise NotMounted(str(getattr(error, "stderr", None) or error)) from error

    def turn_read_only(self) -> None:
        """What the kernel does by itself when it finds an error in the file system, whoever has files open."""
        device = os.stat(self.at).st_dev
        name = Path(f"/sys/dev/block/{os.major(device)}:{os.minor(device)}").resolve().name
        _run("sync", "-f", str(self.at))
        Path(f"/sys/fs/ext4/{name}/trigger_fs_error").write_text("1")

    def cut_power(self) -> None:
        """From now on nothing reaches the disk: what was written and not synced may be lost, as may be its name."""
        handle = os.open(self.at, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.ioctl(handle, SHUTDOWN, struct.pack("I", WITHOUT_LOG))
        finally:
            os.close(handle)

    def mount_again(self) -> None:
        """Switch the power on: the kernel replays the journal of the disk."""
        self._replace()
        self._mount()

    def repair(self) -> None:
        """Unmount, examine, mount: what an operator does."""
        self._replace()
        examined = subprocess.run(["e2fsck", "-f", "-y", str(self._file)], capture_output=True, text=True)
        if examined.returncode not in (0, 1):
            raise OSError(f"e2fsck: {examined.stdout}")
        self._mount()

    def unmount(self) -> None:
        """Take it away; whoever has files open keeps them."""
        if self.at.is_mount():
            _run("umount", "--lazy", str(self.at))

    def _replace(self) -> None:
        """Take it away, and go on with a copy of what is on it: a browser's sandbox may keep the mount."""
        self.unmount()
        copy = self._file.with_suffix(".copy")
        _run("cp", "--sparse=always", str(self._file), str(copy))
        self._file.unlink()
        copy.rename(self._file)

    def _mount(self) -> None:
        _run("mount", "-o", "loop,errors=remount-ro", str(self._file), str(self.at))


@contextmanager
def ext4_disk(folder: Path) -> Iterator[Ext4Disk]:
    """A disk during a block; raises NotMounted."""
    disk = Ext4Disk(folder)
    try:
        yield disk
    finally:
        disk.unmount()


def _run(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout
