"""What is done for one view of a map takes no longer where the map has many: counted in steps of SQLite's machine."""

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from uuid6 import uuid7

from tests.storage.databases import put_tables, sqlite_url
from tests.storage.material import NOW, RECIPE, enroll, finish
from worker.storage.rows import find_map
from worker.storage.store import SqlStore, open_store
from worker.storage.tables import JOBS

MANY = 3000

STEP = 10
"""Instructions of SQLite's machine that are counted together."""


def steps(store: SqlStore, work: Callable[[], object]) -> int:
    """How much SQLite does for something, in `STEP` instructions."""
    count = 0

    def counted() -> int:
        nonlocal count
        count += 1
        return 0

    def watch(connection: Any, *_: object) -> None:
        connection.set_progress_handler(counted, STEP)

    engine = store._database.engine
    sa.event.listen(engine, "checkout", watch)
    try:
        work()
    finally:
        sa.event.remove(engine, "checkout", watch)
    return count


def have_described(store: SqlStore, count: int) -> None:
    """Leave the finished jobs of so many views."""
    with store._database.writing() as connection:
        done = {"kind": "describe", "map_id": find_map(connection, "campus").id, "recipe": RECIPE.description.id}
        rows = [{**done, "id": str(uuid7()), "background": False, "state": "done"} for _ in range(count)]
        connection.execute(sa.insert(JOBS).values(attempts=1, created_at=NOW, finished_at=NOW), rows)


def test_a_view_is_enrolled_described_and_deleted_as_quickly_among_many(data: Path) -> None:
    put_tables(data)
    with closing(open_store(sqlite_url(data), data)) as store:

        def measured(name: str) -> list[int]:
            view, claims = [], []
            return [
                steps(store, lambda: view.append(enroll(store, name).view.id)),
                steps(store, lambda: claims.extend(store.jobs.claim("worker", 1))),
                steps(store, lambda: finish(store, claims[0])),
                steps(store, lambda: store.removals.delete_view(view[0])),
            ]

        for name in ("first", "second"):  # what is looked up once is known then
            measured(name)
        few = measured("among few")
        have_described(store, MANY)
        assert all(many < 1.2 * one for many, one in zip(measured("among many"), few, strict=True))
