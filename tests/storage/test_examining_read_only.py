"""A data folder on a disk that cannot be written is examined as it is, and nothing sound is called damaged."""

import os
import sqlite3
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.storage.databases import sqlite_url
from tests.storage.material import describe_all, enroll
from worker.storage.examining import examine
from worker.storage.store import open_store


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """The folder as it is on a disk that is mounted read-only; for others than root, by its permissions."""
    if os.geteuid() != 0:
        folder.chmod(0o555)
        yield
        folder.chmod(0o755)
        return
    mounted = subprocess.run(["mount", "--bind", str(folder), str(folder)], capture_output=True, text=True)
    if mounted.returncode != 0:
        pytest.skip(f"NOT TRIED: a read-only folder needs the right to mount one ({mounted.stderr.strip()})")
    try:
        subprocess.run(["mount", "-o", "remount,ro,bind", str(folder)], check=True)
        yield
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def kept(data: Path) -> None:
    """A store with two views, closed."""
    store = open_store(sqlite_url(data), data)
    for name in ("gate", "pond"):
        enroll(store, name)
    describe_all(store)
    store.close()


def told(data: Path) -> list[str]:
    return [f"{found.what}; {found.remedy}" for found in examine(sqlite_url(data), data)]


def test_a_sound_folder_has_no_findings(tmp_path: Path) -> None:
    kept(tmp_path)
    with read_only(tmp_path):
        assert told(tmp_path) == []


def test_a_log_that_cannot_be_read_there_is_said_to_be_so_and_not_called_damage(tmp_path: Path) -> None:
    """A killed service leaves a log, and SQLite reads it only where it may write."""
    kept(tmp_path)
    with sqlite3.connect(tmp_path / "revisit.db") as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("UPDATE clock SET revision = revision + 1")
        database.commit()
        log = (tmp_path / "revisit.db-wal").read_bytes()
    database.close()
    (tmp_path / "revisit.db-wal").write_bytes(log)
    with read_only(tmp_path):
        [finding] = told(tmp_path)
    assert "damaged" not in finding
    assert "read-only" in finding
    assert "copy" in finding
