"""A doctor reads rows of PostgreSQL in portions: of kept queries, with their images, there may be gigabytes."""

from contextlib import closing
from pathlib import Path

import pytest
import sqlalchemy as sa

from tests.storage.databases import postgres_tables
from tests.storage.material import enroll
from worker.storage import examining_rows
from worker.storage.dialect import for_reading, reader
from worker.storage.store import open_store
from worker.storage.tables import VIEWS


def test_rows_are_not_all_in_memory_at_once(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(examining_rows, "ROWS", 2)
    with postgres_tables() as url, closing(open_store(url, data)) as store:
        for name in "abcde":
            enroll(store, name)
        with (
            reader(url) as engine,
            engine.connect() as plain,
            for_reading(plain) as connection,
            connection.begin(),
        ):
            rows = examining_rows.scan(connection, VIEWS)
            first = next(rows)
            assert connection.scalar(sa.text("SELECT count(*) FROM pg_cursors")) == 1  # the server has the others
            assert [row.seq for row in (first, *rows)] == [1, 2, 3, 4, 5]
