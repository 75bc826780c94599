"""The tables come from migrations alone, and a data folder is used by those who may."""

import re
from pathlib import Path

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext

from schemas.errors import SetupError
from tests.storage.conftest import Open
from tests.storage.databases import sqlite_url
from tests.storage.material import NOW, enroll
from worker.storage.database import Database
from worker.storage.locks import USE, FolderLock, lock_for_serving
from worker.storage.migrating import migrate, newest
from worker.storage.store import open_store
from worker.storage.tables import METADATA


def set_revision(database: Database, revision: str) -> None:
    with database.writing() as connection:
        connection.execute(sa.text("UPDATE alembic_version SET version_num = :revision"), {"revision": revision})


def test_migrations_make_the_tables_of_the_code(reopen: Open, database_url: str) -> None:
    reopen()
    database = Database(database_url)
    with database.reading() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True, "compare_server_default": True})
        assert compare_metadata(context, METADATA) == []
    database.close()


def test_migrations_make_them_to_the_letter(data: Path) -> None:
    """Beyond what Alembic compares: actions of foreign keys, AUTOINCREMENT, collations."""

    def schema(database: Database) -> dict[str, str]:
        with database.reading() as connection:
            rows = connection.execute(sa.text("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL"))
            return {name: re.sub(r"\s+", " ", sql) for name, sql in rows if not name.startswith("alembic")}

    by_code, by_migrations = Database(sqlite_url(data / "code")), Database(sqlite_url(data))
    (data / "code").mkdir()
    with by_code.writing() as connection:
        METADATA.create_all(connection)
    open_store(sqlite_url(data), data).close()
    assert schema(by_code) == schema(by_migrations)
    by_code.close()
    by_migrations.close()


def test_a_migration_that_fails_leaves_nothing_behind(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("in the middle")

    with monkeypatch.context() as patch:
        patch.setattr("alembic.op.execute", fail)
        with pytest.raises(RuntimeError):
            open_store(sqlite_url(data), data)
    database = Database(sqlite_url(data))
    assert sa.inspect(database.engine).get_table_names() == []
    database.close()
    open_store(sqlite_url(data), data).close()


def test_migrating_twice_changes_nothing(reopen: Open, database_url: str, data: Path) -> None:
    store = reopen()
    view = enroll(store, "gate").view
    store.close()
    assert migrate(database_url, data) == migrate(database_url, data) == newest()
    assert reopen().view(view.id) == view


def test_a_database_of_a_newer_version_is_refused(reopen: Open, database_url: str) -> None:
    reopen().close()
    database = Database(database_url)
    set_revision(database, "9999")
    database.close()
    with pytest.raises(SetupError, match="9999, which is newer"):
        reopen()


def test_a_database_in_use_is_not_migrated(data: Path) -> None:
    share = FolderLock(data / USE)
    share.acquire(shared=True)
    with pytest.raises(SetupError, match="stop all services"):
        open_store(sqlite_url(data), data)
    share.release()
    open_store(sqlite_url(data), data).close()


def test_a_folder_has_one_service_and_the_second_is_told_which(data: Path) -> None:
    first = lock_for_serving(data, NOW)
    with pytest.raises(SetupError, match=r"process \d+ on .+ since 2026-03-01 12:00:00\+00:00; stop"):
        lock_for_serving(data, NOW)
    first.release()
    first.release()
    lock_for_serving(data, NOW).release()


def test_any_number_of_workers_may_use_a_folder_beside_its_service(reopen: Open, data: Path) -> None:
    service = lock_for_serving(data, NOW)
    assert [reopen().check() for _ in range(3)] == ["ok"] * 3
    service.release()


@pytest.mark.parametrize("url", ["moon", "sqlite://", "sqlite:///:memory:", "mysql://localhost/revisit"])
def test_a_database_that_cannot_be_used_is_refused(url: str, data: Path) -> None:
    with pytest.raises(SetupError, match="REVISIT_DATABASE"):
        open_store(url, data)


def test_what_is_no_database_and_no_folder_is_refused_in_words(data: Path) -> None:
    (data / "revisit.db").write_text("a letter home " * 100)
    with pytest.raises(SetupError, match="the database cannot be used: file is not a database"):
        open_store(sqlite_url(data), data)
    with pytest.raises(SetupError, match="the data folder"):
        open_store(sqlite_url(data), data / "revisit.db")


def test_maps_of_a_build_before_the_first_release_are_refused(reopen: Open, database_url: str, data: Path) -> None:
    store = reopen()
    enroll(store, "gate")
    store.close()
    database = Database(database_url)
    with database.writing() as connection:
        connection.execute(sa.text("DROP TABLE cells"))
    set_revision(database, "0001")
    with pytest.raises(SetupError, match="enrol the pictures again"):
        migrate(database_url, data)
    with database.writing() as connection:
        connection.execute(sa.text("DELETE FROM maps"))
    database.close()
    reopen().close()
