"""What PostgreSQL rolls back is run again, if nothing of it was committed; what may have been committed is not."""

import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import psycopg
import pytest
import sqlalchemy as sa

from schemas.errors import StorageFailed
from schemas.map_changes import MapChanges
from schemas.records import Filters, ViewAttributes
from tests.storage.databases import PostgresServer, postgres_schema
from tests.storage.material import describe_all, enroll
from tests.waiting import until
from worker.storage import removals, retrying
from worker.storage.database import Database
from worker.storage.part import Part
from worker.storage.store import SqlStore, open_store
from worker.storage.tables import MAPS

NAME = "run-again"
"""By which the server knows the connections of the store here."""


@pytest.fixture
def url() -> Iterator[str]:
    """A schema of its own on PostgreSQL, whose connections have a name, and which looks for deadlocks late."""
    with postgres_schema() as given:
        parsed = sa.make_url(given)
        options = f"{parsed.query['options']} -c deadlock_timeout=2s"
        named = parsed.update_query_dict({"application_name": NAME, "options": options})
        yield named.render_as_string(hide_password=False)


@pytest.fixture
def store(url: str, data: Path) -> Iterator[SqlStore]:
    with closing(open_store(url, data)) as store:
        yield store


@pytest.fixture
def elsewhere_connected(url: str) -> Iterator[sa.Connection]:
    """Somebody else's connection, whose statements commit by themselves."""
    engine = sa.create_engine(sa.make_url(url).update_query_dict({"application_name": "somebody else"}))
    with engine.connect() as connection:
        yield connection.execution_options(isolation_level="AUTOCOMMIT")
    engine.dispose()


def run(connection: sa.Connection, text: str) -> sa.CursorResult[Any]:
    return connection.execute(sa.text(text))


def terminate(connection: sa.Connection) -> None:
    """End all connections of the store, whatever they do."""
    run(connection, f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE application_name = '{NAME}'")


def raising(connection: sa.Connection, when: str, table: str, code: str, *, call: int) -> None:
    """Have the server itself raise an error at the `call`-th change of a row. Sequences are not rolled back."""
    run(connection, "CREATE SEQUENCE changes")
    run(
        connection,
        "CREATE FUNCTION once() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN "
        f"IF nextval('changes') = {call} THEN RAISE EXCEPTION 'as if others had been there' USING ERRCODE = '{code}'; "
        "END IF; RETURN COALESCE(NEW, OLD); END $$",
    )
    run(connection, f"CREATE TRIGGER once {when} ON {table} FOR EACH ROW EXECUTE FUNCTION once()")


class Pairs(Part):
    """Adds to the counts of two maps in one transaction, in a given order."""

    def add(self, names: tuple[str, str], between: Callable[[], object]) -> str:
        """Add 1 to both; `between` is called in between."""
        with self._database.writing(in_turn=False) as connection:
            for name in names:
                counted = sa.update(MAPS).where(MAPS.c.name == name)
                connection.execute(counted.values(keep_queries=sa.func.coalesce(MAPS.c.keep_queries, 0) + 1))
                if name == names[0]:
                    between()
        return "added"


def test_two_writers_that_lock_each_other_out_both_get_through(store: SqlStore, url: str, data: Path) -> None:
    for name in ("a", "b"):
        enroll(store, name, map=name)
    meeting = threading.Barrier(2)
    met: list[bool] = []
    told: list[str] = []

    def meet() -> None:
        """Both hold one row, and want the other's; when one of them comes again, nobody is waited for."""
        if len(met) < 2:
            met.append(True)
            meeting.wait(30)

    with closing(Database(url)) as one, closing(Database(url)) as other:
        writers = [
            threading.Thread(target=lambda part=part, names=names: told.append(part.add(names, meet)))
            for part, names in (
                (Pairs(one, store.maps._images), ("a", "b")),
                (Pairs(other, store.maps._images), ("b", "a")),
            )
        ]
        for writer in writers:
            writer.start()
        for writer in writers:
            writer.join(60)
    assert told == ["added", "added"]
    assert [record.keep_queries for record in store.maps.all()] == [2, 2]


def test_a_deletion_that_met_a_deadlock_is_done_once(store: SqlStore, elsewhere_connected: sa.Connection) -> None:
    views = [enroll(store, name).view for name in ("gate", "pond", "hall")]
    describe_all(store)
    revision = store.maps.revision("campus")
    other = elsewhere_connected
    run(other, "SET deadlock_timeout = '1h'")  # so that it is the store whose transaction ends
    run(other, "BEGIN")
    run(other, f"SELECT 1 FROM views WHERE seq = {views[2].seq} FOR UPDATE")
    removed = []
    deletion = threading.Thread(target=lambda: removed.append(store.removals.delete_views("campus", Filters())))
    deletion.start()
    waiting = f"SELECT 1 FROM pg_stat_activity WHERE application_name = '{NAME}' AND wait_event_type = 'Lock'"
    until(lambda: run(other, waiting).first() is not None)
    run(other, f"SELECT 1 FROM views WHERE seq = {views[0].seq} FOR UPDATE")  # which the deletion has locked
    run(other, "COMMIT")
    deletion.join(60)
    assert [(one.views, one.images, one.revision) for one in removed] == [(3, 3, revision + 1)]
    assert store.views.list("campus", Filters())[0] == []


def test_a_connection_that_is_ended_in_a_transaction_is_made_anew(
    store: SqlStore, elsewhere_connected: sa.Connection
) -> None:
    view = enroll(store, "gate").view
    revision = store.maps.revision("campus")
    seen = []

    def change(attributes: ViewAttributes) -> ViewAttributes:
        seen.append(attributes.place)
        if len(seen) == 1:
            terminate(elsewhere_connected)
        return ViewAttributes(place="hall")

    assert store.views.change(view.id, change).attributes.place == "hall"
    assert seen == [None, None]
    assert store.maps.revision("campus") == revision + 1


def test_a_read_is_tried_again_too(
    store: SqlStore, elsewhere_connected: sa.Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    enroll(store, "gate")
    ended: list[bool] = []
    listed = sa.Connection.scalars

    def scalars(connection: sa.Connection, *given: object) -> object:
        if not ended:
            ended.append(True)
            terminate(elsewhere_connected)
        return listed(connection, *given)  # type: ignore[call-overload]

    monkeypatch.setattr(sa.Connection, "scalars", scalars)
    assert store.jobs.unfinished_imports() == set()
    assert ended


def test_a_serialisation_failure_is_run_again(store: SqlStore, elsewhere_connected: sa.Connection) -> None:
    """Transactions here read what is committed, so that the server finds no such failure by itself."""
    enroll(store, "gate")
    raising(elsewhere_connected, "BEFORE UPDATE", "maps", "40001", call=1)
    assert store.maps.change("campus", MapChanges(refuse_poor=True)).refuse_poor


def test_one_that_comes_at_the_commit_is_run_again(store: SqlStore, elsewhere_connected: sa.Connection) -> None:
    enroll(store, "gate")
    run(elsewhere_connected, "CREATE TABLE late ()")
    raising(elsewhere_connected, "BEFORE INSERT", "late", "40001", call=1)
    run(
        elsewhere_connected,
        "CREATE FUNCTION tell() RETURNS trigger LANGUAGE plpgsql AS "
        "$$ BEGIN INSERT INTO late DEFAULT VALUES; RETURN NULL; END $$",
    )
    run(
        elsewhere_connected,
        "CREATE CONSTRAINT TRIGGER at_commit AFTER UPDATE ON maps DEFERRABLE INITIALLY DEFERRED "
        "FOR EACH ROW EXECUTE FUNCTION tell()",
    )
    assert store.maps.change("campus", MapChanges(refuse_poor=True)).refuse_poor


def test_a_commit_that_broke_off_is_not_run_again(store: SqlStore, elsewhere_connected: sa.Connection) -> None:
    """The server ends the connection while it commits: from here nobody can tell whether it did."""
    view = enroll(store, "gate").view
    run(
        elsewhere_connected,
        "CREATE FUNCTION die() RETURNS trigger LANGUAGE plpgsql AS "
        "$$ BEGIN PERFORM pg_terminate_backend(pg_backend_pid()); PERFORM pg_sleep(5); RETURN NULL; END $$",
    )
    run(
        elsewhere_connected,
        "CREATE CONSTRAINT TRIGGER at_commit AFTER UPDATE ON views DEFERRABLE INITIALLY DEFERRED "
        "FOR EACH ROW EXECUTE FUNCTION die()",
    )
    seen = []

    def change(attributes: ViewAttributes) -> ViewAttributes:
        seen.append(attributes)
        return ViewAttributes(place="hall")

    with pytest.raises(StorageFailed, match="being stopped"):
        store.views.change(view.id, change)
    assert len(seen) == 1


def test_nothing_is_run_again_after_a_part_was_committed(
    store: SqlStore, elsewhere_connected: sa.Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each portion of a deletion is tried again by itself; in the end the failure is told, with what was done."""
    for name in ("gate", "pond", "hall"):
        enroll(store, name)
    monkeypatch.setattr(removals, "PORTION", 1)
    raising(elsewhere_connected, "BEFORE DELETE", "views", "40P01", call=2)
    assert store.removals.delete_views("campus", Filters()).views == 3

    for name in ("gate", "pond", "hall"):
        enroll(store, name)
    monkeypatch.setattr(retrying, "PAUSES_S", (0.0, 0.0))
    run(elsewhere_connected, "SELECT setval('changes', 1)")
    run(
        elsewhere_connected,
        "CREATE OR REPLACE FUNCTION once() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN "
        "IF nextval('changes') > 2 THEN RAISE EXCEPTION 'again and again' USING ERRCODE = '40P01'; END IF; "
        "RETURN OLD; END $$",
    )
    with pytest.raises(StorageFailed, match="others waited for the same rows"):
        store.removals.delete_views("campus", Filters())
    assert len(store.views.list("campus", Filters())[0]) == 2
    assert run(elsewhere_connected, "SELECT last_value FROM changes").scalar() == 2 + 3


def test_a_method_is_run_so_often_and_no_more(
    store: SqlStore, elsewhere_connected: sa.Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retrying, "PAUSES_S", (0.0, 0.0))
    enroll(store, "gate")
    run(elsewhere_connected, "CREATE SEQUENCE changes")
    run(
        elsewhere_connected,
        "CREATE FUNCTION never() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN PERFORM nextval('changes'); "
        "RAISE EXCEPTION 'again and again' USING ERRCODE = '40001'; END $$",
    )
    run(elsewhere_connected, "CREATE TRIGGER never BEFORE UPDATE ON maps FOR EACH ROW EXECUTE FUNCTION never()")
    with pytest.raises(StorageFailed, match="others changed the same rows") as failed:
        store.maps.change("campus", MapChanges(refuse_poor=True))
    assert type(failed.value) is StorageFailed
    assert run(elsewhere_connected, "SELECT last_value FROM changes").scalar() == 3
    assert not store.maps.get("campus").refuse_poor


@contextmanager
def of_its_own() -> Iterator[tuple[PostgresServer, SqlStore]]:
    """A server that can be stopped, and a store on it."""
    with (
        tempfile.TemporaryDirectory(prefix="revisit-postgresql-") as folder,
        PostgresServer(Path(folder)) as server,
        tempfile.TemporaryDirectory() as data,
        closing(open_store(server.url, Path(data))) as store,
    ):
        yield server, store


def test_a_server_that_is_started_anew_is_waited_for_and_one_that_is_away_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with of_its_own() as (server, store):
        view = enroll(store, "gate").view
        server.stop()
        began = time.monotonic()
        with pytest.raises(StorageFailed, match="no connection"):
            store.views.get(view.id)
        assert time.monotonic() - began < 5

        # A server takes as long to start as the machine has other work: here it is waited for longer.
        monkeypatch.setattr(retrying, "PAUSES_S", (*retrying.PAUSES_S, *[0.5] * 120))
        back = threading.Timer(0.2, server.start)
        back.start()
        try:
            assert store.views.change(view.id, lambda _: ViewAttributes(place="hall")).attributes.place == "hall"
            assert enroll(store, "pond").created
        finally:
            back.join()
        assert store.views.get(view.id).attributes.place == "hall"


def test_a_server_that_is_silent_is_tried_once(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As one behind a cut wire: it takes connections and says nothing, or they are lost on the way."""
    tried: list[float] = []
    with postgres_schema() as url, closing(open_store(url, data)) as store:
        view = enroll(store, "gate").view

        def silent() -> sa.Connection:
            tried.append(time.monotonic())
            time.sleep(0.3)
            raise sa.exc.OperationalError("", None, psycopg.errors.ConnectionTimeout("timeout expired"))

        with monkeypatch.context() as patched:
            patched.setattr("worker.storage.database.PROMPT_S", 0.2)
            patched.setattr(store.views._database.engine, "connect", silent)
            with pytest.raises(StorageFailed, match="no connection"):
                store.views.get(view.id)
            assert len(tried) == 1
            patched.setattr("worker.storage.database.PROMPT_S", 60)
            patched.setattr(retrying, "PAUSES_S", (0.0, 0.0))
            with pytest.raises(StorageFailed, match="no connection"):
                store.views.get(view.id)
            assert len(tried) == 4
        assert store.views.get(view.id).id == view.id
