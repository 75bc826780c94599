"""Calls with an Idempotency-Key whose end cannot be stored: they do not seem to run for a day."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from schemas.errors import Conflict, StorageFailed
from schemas.records import Replay
from tests.storage.databases import postgres_tables
from tests.storage.material import NOW
from worker.storage import clock
from worker.storage.database import Database
from worker.storage.store import SqlStore, open_store

DONE = Replay(201, {"Location": "/views/1"}, b"{}")


@contextmanager
def refusing(monkeypatch: pytest.MonkeyPatch, *, committed: bool = False) -> Iterator[None]:
    """A database that cannot be written; `committed`: it is, but nobody learns of it."""
    usual = Database.writing

    @contextmanager
    def writing(database: Database, **how: Any) -> Iterator[Any]:
        if committed:
            with usual(database, **how) as connection:
                yield connection
        raise StorageFailed("away")

    with monkeypatch.context() as patch:
        patch.setattr(Database, "writing", writing)
        yield


def test_a_call_that_failed_while_nothing_could_be_stored_is_forgotten_later(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.calls.begin("key", "fingerprint", NOW)
    with refusing(monkeypatch), pytest.raises(StorageFailed):
        store.calls.abandon("key")
    assert store.calls.begin("key", "fingerprint", NOW) is None  # at once, where the caller comes back to this process
    with refusing(monkeypatch), pytest.raises(StorageFailed):
        store.calls.abandon("key")
    store.tend()
    with store._database.reading() as connection:
        assert list(connection.exec_driver_sql("SELECT key FROM calls")) == []


def test_an_answer_that_could_not_be_stored_is_stored_later(store: SqlStore, monkeypatch: pytest.MonkeyPatch) -> None:
    store.calls.begin("key", "fingerprint", NOW)
    with refusing(monkeypatch):
        with pytest.raises(StorageFailed):
            store.calls.end("key", DONE, NOW)
        store.tend()
    store.tend()
    assert store.calls.begin("key", "fingerprint", NOW) == DONE


def test_a_beginning_of_which_nobody_knows_whether_it_was_stored_is_forgotten(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    with refusing(monkeypatch, committed=True), pytest.raises(StorageFailed):
        store.calls.begin("key", "fingerprint", NOW)
    assert store.calls.begin("key", "fingerprint", NOW.replace(second=1)) is None
    with pytest.raises(Conflict):  # which runs
        store.calls.begin("key", "fingerprint", NOW.replace(second=2))


def test_of_two_calls_with_a_key_the_one_that_runs_is_not_forgotten_for_the_other(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.calls.begin("key", "fingerprint", NOW)
    with refusing(monkeypatch), pytest.raises(StorageFailed):
        store.calls.begin("key", "fingerprint", NOW.replace(second=1))
    with pytest.raises(Conflict):
        store.calls.begin("key", "fingerprint", NOW.replace(second=2))


def test_a_call_that_cannot_have_an_answer_any_more_may_be_tried_again(store: SqlStore) -> None:
    """Its process was killed while another one of a fleet went on, so that no start cleaned up."""
    store.calls.begin("key", "fingerprint", NOW)
    with pytest.raises(Conflict):
        store.calls.begin("key", "fingerprint", NOW + timedelta(minutes=9))
    assert store.calls.begin("key", "fingerprint", NOW + timedelta(minutes=10)) is None


def test_calls_of_a_fleet_end_by_the_clock_of_the_database_whatever_those_of_the_services_say(
    data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A service whose clock is behind by a day saw its calls forgotten by the others, while they ran."""
    behind, ahead = NOW - timedelta(days=2), NOW + timedelta(days=2)
    with postgres_tables() as url, closing(open_store(url, data)) as store:
        store.calls.begin("done", "fingerprint", behind, shared=True)
        store.calls.end("done", DONE, behind)
        store.calls.begin("runs", "fingerprint", behind, shared=True)
        monkeypatch.setattr(store.calls, "_expires_at", 0)
        store.calls.expire(ahead, shared=True)

        assert store.calls.begin("done", "fingerprint", ahead, shared=True) == DONE
        with pytest.raises(Conflict):
            store.calls.begin("runs", "fingerprint", ahead, shared=True)

        later = datetime.now(UTC) + timedelta(minutes=11)
        monkeypatch.setattr(clock, "shared_time", lambda connection: later)
        assert store.calls.begin("runs", "fingerprint", behind, shared=True) is None


def test_a_beginning_of_which_nobody_knows_is_forgotten_by_the_clock_of_the_database_too(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    with refusing(monkeypatch, committed=True), pytest.raises(StorageFailed):
        store.calls.begin("key", "fingerprint", NOW, shared=True)
    assert store.calls.begin("key", "fingerprint", NOW, shared=True) is None
