"""Images are whole and owned, or not there: whatever fails between the file and its row."""

import errno
import hashlib
import os
import shutil
import sqlite3
import stat
import tracemalloc
from contextlib import closing, suppress
from itertools import count
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Thread
from typing import Any, NoReturn

import pytest
import sqlalchemy as sa

from schemas.errors import Conflict, Damaged, DiskFull, NotFound
from schemas.records import Filters, ViewAttributes
from tests.storage.databases import sqlite_url
from tests.storage.material import NOW, Follower, describe_all, enroll, facts, image
from worker.storage import image_files, wal
from worker.storage.examining import examine
from worker.storage.image_files import Images, sync_folder
from worker.storage.owner_file import OWNER
from worker.storage.store import SqlStore, open_store


class PowerCut(BaseException):
    """The process ends here: nothing after it runs."""


def files(data: Path) -> list[Path]:
    """All files of images, whole or not."""
    return sorted(
        path for path in (data / "pictures").rglob("*") if path.is_file() and path.name not in (".lock", OWNER)
    )


@pytest.fixture
def store(data: Path) -> SqlStore:
    """A store of its own folder; the tests here are about files, so one database will do."""
    return open_store(sqlite_url(data), data)


@pytest.fixture(autouse=True)
def closed(store: SqlStore) -> Any:
    """Close the store after each test."""
    yield
    store.close()


def test_an_image_lies_in_two_levels_of_folders_under_its_digest(store: SqlStore, data: Path) -> None:
    digest = enroll(store, "gate").view.image.sha256
    assert files(data) == [data / "pictures" / digest[:2] / digest[2:4] / digest]
    assert files(data)[0].read_bytes() == image("gate")


def test_an_image_is_durable_under_its_name_before_its_row_is_committed(
    store: SqlStore, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    events: list[str] = []
    sync, rename = os.fsync, Path.rename

    def note_sync(handle: int) -> None:
        events.append("folder" if stat.S_ISDIR(os.fstat(handle).st_mode) else "file")
        sync(handle)

    def note_rename(self: Path, target: Path) -> Path:
        events.append("rename")
        return rename(self, target)

    monkeypatch.setattr(os, "fsync", note_sync)
    monkeypatch.setattr(Path, "rename", note_rename)
    sa.event.listen(store._database.engine, "commit", lambda _: events.append("commit"))

    enroll(store, "gate")

    assert events == ["file", "rename", "folder", "folder", "folder", "commit"]


def test_a_folder_is_made_durable_once_by_each_process(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that is there may be of a process that died before that."""
    digests = {hashlib.sha256(body := str(number).encode()).hexdigest(): body for number in range(10_000)}
    alike = [(digest, body) for digest, body in digests.items() if digest.startswith("c0")][:2]
    folders: list[Path] = []
    sync = image_files.sync_folder

    def note(folder: Path) -> None:
        folders.append(folder)
        sync(folder)

    monkeypatch.setattr(image_files, "sync_folder", note)
    for images in (Images(data / "pictures", owned=set), Images(data / "pictures", owned=set)):
        for number, (digest, body) in enumerate(alike):
            folders.clear()
            with images.kept(digest, body):
                pass
            above = [data / "pictures"] if number == 0 else []
            first = data / "pictures" / "c0"
            assert folders == [first / digest[2:4], first, *above]


@pytest.mark.parametrize("kind", [PowerCut, RuntimeError])
def test_a_row_that_fails_takes_its_file_with_it(
    store: SqlStore, data: Path, monkeypatch: pytest.MonkeyPatch, kind: type[BaseException]
) -> None:
    def fail(*_: object) -> NoReturn:
        raise kind

    monkeypatch.setattr("worker.storage.enrolment.keep_pairs", fail)
    with pytest.raises(kind):
        enroll(store, "gate")
    assert files(data) == []
    assert store.maps.all() == []


def test_a_crash_between_file_and_row_leaves_a_file_that_recovery_sweeps(store: SqlStore, data: Path) -> None:
    kept = enroll(store, "pond").view
    orphan = Images(data / "pictures", owned=lambda digests: set(digests))
    with pytest.raises(PowerCut), orphan.kept(facts(image("gate")).sha256, image("gate")):
        raise PowerCut
    assert len(files(data)) == 2

    store.recover()

    assert [path.name for path in files(data)] == [kept.image.sha256]
    assert store.views.image(kept.id) == image("pond")


def test_images_of_rows_that_a_damaged_log_lost_are_not_swept_away(
    store: SqlStore, data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """SQLite takes commits behind a damaged byte of its log for never made; only the images are left of their views."""
    for number in range(20):
        enroll(store, f"gate {number}")
    copy = tmp_path / "data"  # as it lies when the process is killed: the log is not copied into the database
    shutil.copytree(data, copy)
    log = copy / "revisit.db-wal"
    content = bytearray(log.read_bytes())
    content[len(content) * 2 // 3] ^= 1
    log.write_bytes(content)

    opened = open_store(sqlite_url(copy), copy)
    opened.recover()
    rows = opened.views.list(None, Filters())[0]
    opened.close()

    assert 0 < len(rows) < 20
    assert len(files(copy)) == 20
    assert "doctor --repair" in caplog.text


@pytest.mark.parametrize("page", [0, 100, 8192])
def test_a_log_whose_last_frame_is_unfinished_is_that_of_a_killed_process(
    store: SqlStore, data: Path, tmp_path: Path, page: int
) -> None:
    """The images of its enrolments that were never acknowledged are swept as after any crash."""
    enroll(store, "pond")
    orphan = Images(data / "pictures", owned=lambda digests: set(digests))
    with pytest.raises(PowerCut), orphan.kept(facts(image("gate")).sha256, image("gate")):
        raise PowerCut
    copy = tmp_path / "data"
    shutil.copytree(data, copy)
    log = copy / "revisit.db-wal"
    content = log.read_bytes()
    # One more frame of this round: its header, and a part of its page or what an earlier round left there.
    log.write_bytes(content + content[32:56] + bytes(page))

    opened = open_store(sqlite_url(copy), copy)
    opened.recover()
    opened.close()

    assert [path.name for path in files(copy)] == [facts(image("pond")).sha256]


@pytest.mark.parametrize("damaged", [False, True])
def test_a_log_of_a_process_that_was_killed_in_a_long_transaction(
    damaged: bool, store: SqlStore, data: Path, tmp_path: Path
) -> None:
    """What the cache does not hold is in the log before the commit, and SQLite writes it over there: such frames do not
    fit their checksums, and hide no commit."""
    for number in range(20):
        enroll(store, f"gate {number}")
    committed = (data / "revisit.db-wal").stat().st_size
    copy = tmp_path / "data"
    with closing(sqlite3.connect(data / "revisit.db", isolation_level=None)) as migrating:
        migrating.execute("PRAGMA cache_size=5")
        migrating.execute("BEGIN IMMEDIATE")
        migrating.execute("CREATE TABLE long (number INTEGER PRIMARY KEY, body BLOB)")
        for _ in range(3):
            for number in range(100):
                migrating.execute("INSERT OR REPLACE INTO long VALUES (?, randomblob(8000))", [number])
        shutil.copytree(data, copy)
        migrating.execute("ROLLBACK")
    log = copy / "revisit.db-wal"
    assert log.stat().st_size > committed + 100 * 8192
    if damaged:
        content = bytearray(log.read_bytes())
        content[committed * 2 // 3] ^= 1
        log.write_bytes(content)

    fault = wal.fault(log)
    found = [finding.what for finding in examine(sqlite_url(copy), copy)]

    assert (fault is not None, bool(found)) == (damaged, damaged)


def test_a_log_is_looked_through_without_all_of_it_in_memory(data: Path) -> None:
    with closing(sqlite3.connect(data / "revisit.db", isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("CREATE TABLE long (body BLOB)")
        connection.execute("INSERT INTO long VALUES (zeroblob(20000000))")
        tracemalloc.start()
        try:
            assert wal.fault(data / "revisit.db-wal") is None
            assert tracemalloc.get_traced_memory()[1] < 2_000_000
        finally:
            tracemalloc.stop()


def test_a_crash_while_writing_leaves_an_unfinished_file_that_recovery_sweeps(store: SqlStore, data: Path) -> None:
    enroll(store, "gate")
    [whole] = files(data)
    unfinished = whole.parent.parent / ".writing-of-a-dead-process"
    unfinished.write_bytes(b"half a pic")
    store.recover()
    assert files(data) == [whole]


def test_a_crash_between_the_deletion_of_a_row_and_its_file_is_made_good(
    store: SqlStore, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    view = enroll(store, "gate").view

    def cut(*_: object) -> NoReturn:
        raise PowerCut

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", cut)
        with pytest.raises(PowerCut):
            store.removals.delete_view(view.id)
    with pytest.raises(NotFound):
        store.views.get(view.id)
    assert len(files(data)) == 1
    store.recover()
    assert files(data) == []


def test_a_full_disk_is_said_and_leaves_nothing_behind(
    store: SqlStore, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> NoReturn:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(DiskFull):
            enroll(store, "gate")
    assert files(data) == []
    assert store.maps.all() == []
    enroll(store, "gate")


def test_a_full_database_is_said_and_leaves_nothing_behind(store: SqlStore, data: Path) -> None:
    view = enroll(store, "gate").view
    describe_all(store)

    @sa.event.listens_for(store._database.engine, "checkout")
    def no_more_pages(connection: Any, *_: object) -> None:
        connection.execute("PRAGMA max_page_count = 1").close()  # not below the present size

    def fill() -> None:
        for number in range(100):
            enroll(store, f"{number}", attributes=ViewAttributes(metadata={"text": "long " * 2000}))

    with pytest.raises(DiskFull):
        fill()

    views, _ = store.views.list("campus", Filters(), limit=200)
    assert {path.name for path in files(data)} == {view.image.sha256 for view in views}
    assert store.views.get(view.id).state == "ready"
    assert store.removals.delete_view(view.id).views == 1


def test_a_conflict_leaves_the_image_of_the_view_that_is_there(store: SqlStore, data: Path) -> None:
    view = enroll(store, "gate", attributes=ViewAttributes("gate")).view
    with pytest.raises(Conflict):
        enroll(store, "gate", attributes=ViewAttributes("pond"))
    assert store.views.image(view.id) == image("gate")


def test_a_lost_file_is_healed_by_enrolling_its_image_again(store: SqlStore, data: Path) -> None:
    view = enroll(store, "gate").view
    files(data)[0].unlink()
    with pytest.raises(Damaged, match="is missing; enrol the image again"):
        store.views.image(view.id)
    enroll(store, "gate")
    assert store.views.image(view.id) == image("gate")


def test_an_image_enrolled_while_others_sweep_and_delete_it_is_never_taken_away(store: SqlStore, data: Path) -> None:
    stop = False

    def sweep() -> None:
        while not stop:
            store.recover()

    def come_and_go() -> None:
        while not stop:
            view = enroll(store, "gate", map="museum").view
            store.removals.delete_view(view.id)

    others = [Thread(target=sweep), Thread(target=come_and_go)]
    for other in others:
        other.start()
    try:
        for _ in range(25):
            view = enroll(store, "gate").view
            assert store.views.image(view.id) == image("gate")
            assert store.removals.delete_view(view.id).views == 1
    finally:
        stop = True
        for other in others:
            other.join()
    assert files(data) == []
    assert Follower(store).catch_up().vectors == {}


def _enroll_until_killed(url: str, data: Path, acknowledged: Connection) -> None:
    store = open_store(url, data)
    for number in count():
        view = enroll(store, f"{number}").view
        acknowledged.send(view.id)
        describe_all(store)
        if number % 4 == 3:
            store.removals.delete_view(view.id)


def test_what_was_acknowledged_before_a_kill_is_there_after_it_and_nothing_else(store: SqlStore, data: Path) -> None:
    spawn = get_context("spawn")
    receive, send = spawn.Pipe(duplex=False)
    process = spawn.Process(target=_enroll_until_killed, args=(sqlite_url(data), data, send))
    process.start()
    acknowledged = [receive.recv() for _ in range(15)]
    process.kill()
    process.join()
    send.close()
    with suppress(EOFError, OSError):  # it may have died in the middle of a word
        while True:
            acknowledged.append(receive.recv())
    receive.close()

    store.recover()

    views, _ = store.views.list("campus", Filters(), limit=1000)
    kept = {view.id for view in views}
    for number, view_id in enumerate(acknowledged[:-1]):  # what came after the last one was cut short
        assert (view_id in kept) == (number % 4 != 3)
    assert {path.name for path in files(data)} == {view.image.sha256 for view in views}
    assert all(facts(store.views.image(view.id)) == view.image for view in views)
    store.workers.bury([], NOW)
    describe_all(store)
    assert Follower(store).catch_up().vectors.keys() == {view.seq for view in views}


def test_a_folder_that_is_gone_is_noticed(store: SqlStore, data: Path) -> None:
    assert store.check() == "ok"
    (data / "pictures").rename(data / "elsewhere")
    assert "pictures" in store.check()
    (data / "elsewhere").rename(data / "pictures")
    sync_folder(data)
