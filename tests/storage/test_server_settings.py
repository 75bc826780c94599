"""What is set for a PostgreSQL server, a database or a user: promises hold all the same, refusals say what is set."""

import uuid
from collections.abc import Callable, Iterator
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from schemas.errors import DiskFull, SetupError, StorageFailed
from schemas.records import Filters, Position, ViewAttributes
from schemas.where import condition
from tests.storage.databases import postgres_schema
from tests.storage.material import NOW, describe_all, enroll, finish
from worker.storage import dialect
from worker.storage.store import SqlStore, open_store


class Server:
    """A schema, a user of its own, and somebody with all rights; what is set for the user is set for a store."""

    def __init__(self, url: str) -> None:
        self.user = f"user_{uuid.uuid4().hex}"
        parsed = sa.make_url(url)
        self.url = parsed.set(username=self.user).render_as_string(hide_password=False)
        self._engine = sa.create_engine(parsed, isolation_level="AUTOCOMMIT")
        self.connection = self._engine.connect()
        self.run(f"CREATE ROLE {self.user} LOGIN SUPERUSER")

    def run(self, text: str) -> Any:
        return self.connection.execute(sa.text(text))

    def set(self, name: str, value: str) -> None:
        """For the user's connections from now on."""
        self.run(f"ALTER ROLE {self.user} SET {name} = {value}")

    def close(self) -> None:
        self.run(f"REASSIGN OWNED BY {self.user} TO CURRENT_USER")
        self.run(f"DROP OWNED BY {self.user}")
        self.run(f"DROP ROLE {self.user}")
        self.connection.close()
        self._engine.dispose()


@pytest.fixture
def server() -> Iterator[Server]:
    with postgres_schema() as url, closing(Server(url)) as made:
        yield made


def opened(server: Server, data: Path) -> "closing[SqlStore]":
    return closing(open_store(server.url, data))


def test_a_url_as_hosts_of_databases_give_it_is_one_of_postgresql(server: Server, data: Path) -> None:
    with closing(open_store(server.url.replace("postgresql://", "postgres://"), data)) as store:
        view = enroll(store, "gate").view
        assert store.views.get(view.id) == view


@pytest.mark.parametrize(("is_set", "holds"), [("off", "on"), ("local", "local"), ("remote_apply", "remote_apply")])
def test_what_is_acknowledged_is_durable_also_where_the_server_would_not_wait(
    server: Server, data: Path, is_set: str, holds: str
) -> None:
    server.set("synchronous_commit", is_set)
    with opened(server, data) as store, store._database.writing() as connection:
        assert connection.scalar(sa.text("SHOW synchronous_commit")) == holds


@pytest.mark.parametrize(
    ("name", "value"), [("datestyle", "'SQL, DMY'"), ("timezone", "'America/New_York'"), ("client_encoding", "LATIN1")]
)
def test_how_the_server_would_write_values_changes_none(server: Server, data: Path, name: str, value: str) -> None:
    server.set(name, value)
    with opened(server, data) as store:
        enroll(store, "gate", map="campus")
        view = store.views.get(enroll(store, "広場").view.id)
        describe_all(store)
        assert view.enrolled_at == NOW


def test_numbers_that_the_server_would_round_are_no_damage(server: Server, data: Path) -> None:
    """As PostgreSQL 11 and older wrote them: views with a position no longer fitted their checksum, and were failed."""
    server.set("extra_float_digits", "0")
    with opened(server, data) as store:
        exact = Position(x=0.1 + 0.2, y=1 / 3, heading=100 / 3)
        view = enroll(store, "gate", attributes=ViewAttributes(position=exact)).view
        describe_all(store)
        found = store.views.get(view.id)
        assert found.attributes.position == exact
        assert found.state == "ready"


@pytest.mark.parametrize("zone", ["America/New_York", "Asia/Tokyo"])
def test_the_first_and_the_last_times_are_read_in_every_zone(server: Server, data: Path, zone: str) -> None:
    """What programs write for no time: 0001-01-01T00:00:00Z of Go and .NET, and .NET's greatest."""
    server.set("timezone", f"'{zone}'")
    with opened(server, data) as store:
        for name, moment in {"gate": datetime.min, "pond": datetime.max}.items():
            captured_at = moment.replace(tzinfo=UTC)
            view = enroll(store, name, attributes=ViewAttributes(captured_at=captured_at)).view
            assert store.views.get(view.id).attributes.captured_at == captured_at


def test_a_reader_does_not_wait_without_end_for_a_locked_table(
    server: Server, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dialect, "READS_WAIT_S", 0.2)
    with opened(server, data) as store:
        view = enroll(store, "gate").view
        server.run("BEGIN")
        server.run("LOCK TABLE views IN ACCESS EXCLUSIVE MODE")
        with pytest.raises(StorageFailed, match="locked"):
            store.views.get(view.id)
        server.run("ROLLBACK")
        assert store.views.get(view.id).id == view.id


def test_a_statement_that_the_server_cuts_short_fails_no_view(server: Server, data: Path) -> None:
    with opened(server, data) as store:
        view = enroll(store, "gate").view
        [claim] = store.jobs.claim("worker", 1)
        server.set("statement_timeout", "200")
    server.run("BEGIN")
    server.run(f"SELECT pg_advisory_xact_lock({dialect.WRITERS})")
    with opened(server, data) as store:
        with pytest.raises(StorageFailed, match="statement_timeout"):
            finish(store, claim)
        server.run("ROLLBACK")
        finish(store, claim)
        assert store.views.get(view.id).state == "ready"


def test_a_right_that_was_taken_away_is_told(server: Server, data: Path) -> None:
    with opened(server, data) as store:
        view = enroll(store, "gate").view
        schema = server.run("SELECT current_schema()").scalar()
        server.run(f"ALTER ROLE {server.user} NOSUPERUSER")
        server.run(f"GRANT USAGE ON SCHEMA {schema} TO {server.user}")
        server.run("ALTER TABLE views OWNER TO CURRENT_USER")
        with pytest.raises(StorageFailed, match="its user may not"):
            store.views.get(view.id)


def test_a_user_who_may_not_make_tables_is_told_which_right_is_missing(server: Server, data: Path) -> None:
    """Since PostgreSQL 15 nobody but its owner may in the schema ``public`` of a database."""
    schema = server.run("SELECT current_schema()").scalar()
    server.run(f"ALTER ROLE {server.user} NOSUPERUSER")
    server.run(f"GRANT USAGE ON SCHEMA {schema} TO {server.user}")
    with pytest.raises(SetupError, match=f"permission denied for schema {schema}.*grant that"):
        open_store(server.url, data)


def test_a_full_disk_of_the_server_is_not_told_to_be_emptied_by_deletions(server: Server, data: Path) -> None:
    with opened(server, data) as store:
        view = enroll(store, "gate").view
        server.run(
            "CREATE FUNCTION full_disk() RETURNS trigger LANGUAGE plpgsql AS "
            "$$ BEGIN RAISE 'could not extend file' USING ERRCODE = '53100'; END $$"
        )
        server.run("CREATE TRIGGER full_disk BEFORE DELETE ON views FOR EACH ROW EXECUTE FUNCTION full_disk()")
        with pytest.raises(DiskFull, match="make room there"):
            store.removals.delete_view(view.id)


def test_a_database_that_takes_writes_again_is_written_without_a_new_start(server: Server, data: Path) -> None:
    """Connections keep what was set when they began."""
    open_store(server.url, data).close()
    server.set("default_transaction_read_only", "on")
    with opened(server, data) as store:
        with pytest.raises(StorageFailed, match="default_transaction_read_only"):
            enroll(store, "gate")
        assert "default_transaction_read_only" in store.check_space()
        server.set("default_transaction_read_only", "off")
        assert store.check_space() == "ok"
        enroll(store, "gate")


def test_a_server_that_gives_no_connection_says_why(server: Server, data: Path) -> None:
    with opened(server, data) as store:
        server.run(f"ALTER ROLE {server.user} CONNECTION LIMIT 0 NOSUPERUSER")
        store._database.engine.dispose()
        with pytest.raises(StorageFailed, match="too many connections") as told:
            store.maps.all()
        assert server.user not in told.value.detail
        server.run(f"ALTER ROLE {server.user} SUPERUSER")


def test_a_service_counts_again_once_its_connection_was_ended(server: Server, data: Path) -> None:
    def alone(store: SqlStore) -> bool:
        with store._peers.joined() as found:
            return found

    with opened(server, data) as store, closing(open_store(server.url, data / "other")) as other:
        assert alone(store)
        server.run(f"SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE usename = '{server.user}'")
        store.tend()
        assert not alone(other)


def test_a_pooler_by_transaction_is_refused(server: Server, data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind one each service took itself for the only one, and prepared statements of others were its own."""
    url = sa.make_url(server.url).set(drivername="postgresql+psycopg")
    engine = sa.create_engine(url, poolclass=sa.pool.StaticPool)
    monkeypatch.setattr(dialect, "make_engine", lambda url: engine)
    with pytest.raises(SetupError, match="pool by session"):
        open_store(server.url, data)


def test_one_that_left_or_never_joined_does_not_count(server: Server, data: Path) -> None:
    with opened(server, data) as store, closing(open_store(server.url, data / "other")) as worker:
        worker.tend()
        with store._peers.joined() as alone:
            assert alone


@pytest.fixture
def encoded_as(server: Server) -> Iterator[Callable[[str], str]]:
    """Makes a database of an encoding; returns its URL."""
    made: list[str] = []

    def make(encoding: str) -> str:
        made.append(f"database_{uuid.uuid4().hex}")
        server.run(f"CREATE DATABASE {made[-1]} ENCODING '{encoding}' TEMPLATE template0 LC_COLLATE 'C' LC_CTYPE 'C'")
        url = sa.make_url(server.url).set(database=made[-1]).difference_update_query(["options"])
        return url.render_as_string(hide_password=False)

    yield make
    for name in made:
        server.run(f"DROP DATABASE {name}")


def test_a_database_without_an_encoding_is_refused_and_one_that_was_made_holds_every_character(
    encoded_as: Callable[[str], str], data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It finds places by how they begin; metadata with other letters than English ones it cannot look into."""
    url = encoded_as("SQL_ASCII")
    with pytest.raises(SetupError, match=r"SQL_ASCII.*ENCODING 'UTF8'"):
        open_store(url, data)
    with monkeypatch.context() as patch:  # as an earlier version did
        patch.setattr(dialect, "encoding_of", lambda connection: None)
        open_store(url, data).close()
    with closing(open_store(url, data)) as store:
        view = enroll(store, "gate", attributes=ViewAttributes(place="広場/1", metadata={"名": "門"})).view
        assert store.views.get(view.id).attributes.place == "広場/1"
        begins = Filters(where=condition({"place": {"$prefix": "広"}}))
        assert [one.id for one in store.views.list("campus", begins)[0]] == [view.id]
        with pytest.raises(SetupError, match="ENCODING 'UTF8'"):
            store.views.list("campus", Filters(where=condition({"metadata.floor": 1})))


def test_a_database_that_could_not_is_refused_and_one_that_was_made_says_what_it_lacks(
    encoded_as: Callable[[str], str], data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = encoded_as("LATIN1")
    with pytest.raises(SetupError, match=r"LATIN1.*ENCODING 'UTF8'"):
        open_store(url, data)
    with monkeypatch.context() as patch:  # as an earlier version did
        patch.setattr(dialect, "encoding_of", lambda connection: None)
        open_store(url, data).close()
    with closing(open_store(url, data)) as store:
        enroll(store, "gate", attributes=ViewAttributes(place="Plätze"))
        with pytest.raises(SetupError, match="ENCODING 'UTF8'"):
            enroll(store, "pond", attributes=ViewAttributes(place="広場"))
