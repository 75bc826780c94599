"""A file written past the system's cache holds what was given, whatever disk it lies on."""

import errno
import fcntl
import hashlib
import os
from pathlib import Path
from typing import NoReturn

import pytest
from hypothesis import given, strategies as st

from worker.storage import uncached_file
from worker.storage.uncached_file import SIZE, UncachedFile

BLOCK = 4096
PIECES = [os.urandom(SIZE - 10), b"", os.urandom(3 * SIZE), os.urandom(1000)]


@given(st.lists(st.binary(max_size=3 * BLOCK), max_size=6), st.lists(st.binary(max_size=3 * BLOCK), max_size=6))
def test_what_was_written_is_in_it_and_in_the_digest(
    tmp_path_factory: pytest.TempPathFactory, before: list[bytes], pieces: list[bytes]
) -> None:
    path, digest = tmp_path_factory.mktemp("files") / "file", hashlib.sha256()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(uncached_file, "SIZE", BLOCK)
        with UncachedFile(path) as file:
            file.write(before)
            file.write(pieces, digest)
            file.sync()
    assert path.read_bytes() == b"".join(before + pieces)
    assert digest.digest() == hashlib.sha256(b"".join(pieces)).digest()


@pytest.mark.parametrize("where", ["disk", "memory"])
def test_bytes_are_replaced_and_more_is_appended(where: str, tmp_path: Path) -> None:
    folder = tmp_path if where == "disk" else Path("/dev/shm")
    path = folder / f"revisit-test-{os.getpid()}"
    try:
        with UncachedFile(path) as file:
            file.write(PIECES)
            file.replace(7, b"seven")
            file.write([b"more"])
            file.sync()
        whole = bytearray(b"".join([*PIECES, b"more"]))
        whole[7:12] = b"seven"
        assert path.read_bytes() == whole
    finally:
        path.unlink(missing_ok=True)


def test_a_file_system_without_a_way_past_its_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    control = fcntl.fcntl

    def refuse(handle: int, command: int, flags: int = 0) -> int:
        if flags & getattr(os, "O_DIRECT", 0):
            raise OSError(errno.EINVAL, "Invalid argument")
        return control(handle, command, flags)

    monkeypatch.setattr(fcntl, "fcntl", refuse)
    with UncachedFile(tmp_path / "file") as file:
        file.write(PIECES)
        file.sync()
    assert (tmp_path / "file").read_bytes() == b"".join(PIECES)


def test_a_disk_that_takes_odd_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What follows a part that ends within a block cannot be written past the cache."""
    write = os.write
    monkeypatch.setattr(os, "write", lambda handle, rest: write(handle, rest[:1_000_000]))
    with UncachedFile(tmp_path / "file") as file:
        file.write(PIECES)
        file.sync()
    assert (tmp_path / "file").read_bytes() == b"".join(PIECES)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EINVAL])
def test_an_error_of_the_disk_is_raised(number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> NoReturn:
        raise OSError(number, os.strerror(number))

    with UncachedFile(tmp_path / "file") as file:
        monkeypatch.setattr(os, "write", fail)
        with pytest.raises(OSError, match=os.strerror(number)):
            file.write(PIECES)


def test_an_existing_file_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(FileExistsError):
        UncachedFile(tmp_path / "file")
