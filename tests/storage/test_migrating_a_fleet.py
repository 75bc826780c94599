"""The tables of a PostgreSQL database are not changed under services on other machines."""

from contextlib import closing
from pathlib import Path

import pytest

from schemas.errors import SetupError
from tests.storage.databases import postgres_tables
from tests.storage.test_migrations import set_revision
from worker.storage.database import Database
from worker.storage.migrating import create, current, known, migrate, newest
from worker.storage.store import open_store

BEFORE = known()[1]


def revision(url: str) -> str | None:
    with closing(Database(url)) as database, database.reading() as connection:
        return current(connection)


def put_back(url: str) -> None:
    with closing(Database(url)) as database:
        set_revision(database, BEFORE)


def test_a_database_that_is_served_elsewhere_is_not_migrated(tmp_path: Path) -> None:
    with postgres_tables() as url, closing(open_store(url, tmp_path / "far")) as far:
        far.recover()  # as a service does when it starts
        put_back(url)
        with pytest.raises(SetupError, match=r"on another machine.*; stop all services and workers"):
            migrate(url, tmp_path / "here")
        assert revision(url) == BEFORE


def test_tables_that_another_service_made_a_moment_ago_are_there(tmp_path: Path) -> None:
    with postgres_tables() as url, closing(open_store(url, tmp_path)) as first, closing(Database(url)) as second:
        first.recover()
        create(second)
        assert revision(url) == newest()


def test_once_nobody_serves_it_any_more_it_is_migrated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with postgres_tables() as url:
        with closing(open_store(url, tmp_path / "far")) as far:
            far.recover()
            put_back(url)
        begun = []
        monkeypatch.setattr("worker.storage.migrating.command.upgrade", lambda *of: begun.append(of[1]))
        migrate(url, tmp_path / "here")
        assert begun == ["head"]
