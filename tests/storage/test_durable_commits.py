"""What is acknowledged waits for the disk, and only that does: flash wears out by what is synced."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from schemas.records import JobProgress
from tests.storage.databases import sqlite_url
from tests.storage.material import NOW, enroll, finish, give_sign
from worker.storage import dialect
from worker.storage.store import SqlStore, open_store

NORMAL, FULL = 1, 2


@pytest.fixture
def store(tmp_path: Path) -> Iterator[SqlStore]:
    """On SQLite: PostgreSQL waits for the disk at each commit."""
    with closing(open_store(sqlite_url(tmp_path), tmp_path)) as store:
        yield store


@contextmanager
def levels(store: SqlStore) -> Iterator[list[int]]:
    """How durable the transactions of the block that write are, as SQLite numbers it."""
    found: list[int] = []

    def note(connection: Any) -> None:
        if connection.get_execution_options().get("writes"):
            found.append(connection.exec_driver_sql("PRAGMA synchronous").scalar())

    sa.event.listen(store._database.engine, "begin", note)
    try:
        yield found
    finally:
        sa.event.remove(store._database.engine, "begin", note)


def test_who_works_on_what_is_not_synced_and_all_else_is(store: SqlStore) -> None:
    with levels(store) as enrolling:
        enroll(store, "gate")
    with levels(store) as claiming:
        give_sign(store, "worker")
        [claim] = store.jobs.claim("worker", 1)
    with levels(store) as describing:
        finish(store, claim)
        store.jobs.queue_snapshot("campus", NOW)
    with levels(store) as working:
        job = store.jobs.claim_map_job("worker", NOW)
        assert job is not None
        store.jobs.report(job, JobProgress(0, 1))
    with levels(store) as ending:
        store.jobs.finish_snapshot(job, {}, NOW)

    assert {*claiming, *working} == {NORMAL}
    assert {*enrolling, *describing, *ending} == {FULL}


def test_a_connection_is_durable_again_after_a_claim_that_failed(store: SqlStore) -> None:
    with pytest.raises(RuntimeError), store._database.writing(durable=False):
        raise RuntimeError
    with levels(store) as after, store._database.writing():
        pass
    assert after == [FULL]


def test_a_connection_that_cannot_be_made_durable_again_is_not_used_again(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    pragma = dialect._set

    def fail(connection: sa.Connection, text: str) -> None:
        if text == dialect.DURABLE:
            raise sa.exc.DBAPIError("PRAGMA", None, OSError("disk I/O error"))
        pragma(connection, text)

    with monkeypatch.context() as broken:
        broken.setattr(dialect, "_set", fail)
        with pytest.raises(sa.exc.DBAPIError), store._database.writing(durable=False):
            pass
    with levels(store) as after, store._database.writing():
        pass
    assert after == [FULL]
