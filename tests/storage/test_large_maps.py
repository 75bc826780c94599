"""What is done for one view takes no longer where there are many: counted in steps of SQLite's machine."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from uuid6 import uuid7

from schemas.ageing import DayScore
from schemas.map_changes import MapChanges
from schemas.records import ViewAttributes
from tests.storage.databases import put_tables, sqlite_url
from tests.storage.material import NOW, RECIPE, describe_all, enroll, finish
from worker.storage.rows import find_map
from worker.storage.store import SqlStore, open_store
from worker.storage.tables import CALLS, JOBS

MANY = 3000

STEP = 10
"""Instructions of SQLite's machine that are counted together."""


def steps(store: SqlStore, work: Callable[[], object]) -> int:
    """How much SQLite does for something, in `STEP` instructions."""
    return _counted(store, "checkout", lambda raw: (raw, True), work)


def steps_in_turn(store: SqlStore, work: Callable[[], object]) -> int:
    """The same, of what is done while nobody else may write."""

    def in_turn(connection: sa.Connection) -> tuple[Any, bool]:
        return connection.connection.dbapi_connection, bool(connection.get_execution_options().get("writes"))

    return _counted(store, "begin", in_turn, work)


def _counted(store: SqlStore, event: str, of: Callable[[Any], tuple[Any, bool]], work: Callable[[], object]) -> int:
    """Steps of the connections that an event names; `of` gives SQLite's own one, and whether it counts from then on."""
    count = 0

    def counted() -> int:
        nonlocal count
        count += 1
        return 0

    def watch(connection: Any, *_: object) -> None:
        raw, counts = of(connection)
        raw.set_progress_handler(counted if counts else None, STEP)

    engine = store._database.engine
    sa.event.listen(engine, event, watch)
    try:
        work()
    finally:
        sa.event.remove(engine, event, watch)
    return count


def have_answered(store: SqlStore, count: int) -> None:
    """Leave the answers to so many calls, which tell of other views."""
    now = datetime.now(UTC)
    told = {"fingerprint": "", "begun_at": now - timedelta(hours=1), "finished_at": now, "status": 201, "headers": "{}"}
    with store._database.writing() as connection:
        rows = [{"key": str(uuid7()), "body": f'{{"view": {{"id": "{uuid7()}"}}}}'.encode()} for _ in range(count)]
        connection.execute(sa.insert(CALLS).values(**told), rows)


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


def test_a_view_is_changed_while_others_write_however_many_answers_are_kept(data: Path) -> None:
    put_tables(data)
    with closing(open_store(sqlite_url(data), data)) as store:
        view = enroll(store, "gate", attributes=ViewAttributes("east")).view

        def measured(place: str) -> int:
            return steps_in_turn(store, lambda: store.views.change(view.id, lambda has: replace(has, place=place)))

        measured("north")
        few = measured("west")
        have_answered(store, MANY)
        assert 0 < measured("south") < 1.2 * few


def test_a_call_with_a_key_begins_as_quickly_among_many(data: Path) -> None:
    put_tables(data)
    with closing(open_store(sqlite_url(data), data)) as store:

        def measured() -> int:
            return steps_in_turn(store, lambda: store.calls.begin(str(uuid7()), "", datetime.now(UTC)))

        measured()
        few = measured()
        have_answered(store, MANY)
        assert 0 < measured() < 1.2 * few


def test_a_page_of_jobs_reads_the_rows_of_no_others(data: Path) -> None:
    put_tables(data)
    with closing(open_store(sqlite_url(data), data)) as store:
        page = partial(store.jobs.list, "campus", kinds=["describe"], limit=10)
        enroll(store, "gate")
        have_described(store, 10)
        page()
        few = steps(store, page)
        have_described(store, MANY)
        each = (steps(store, page) - few) * STEP / MANY
        assert each < 25  # instructions; 44 where whole rows are put in order


def test_the_row_of_a_view_is_read_once_for_all_days_on_which_it_was_matched(data: Path) -> None:
    put_tables(data)
    with closing(open_store(sqlite_url(data), data)) as store:
        view = enroll(store, "gate").view
        describe_all(store)
        store.maps.change("campus", MapChanges(keep_matches=5))
        read = partial(store.day_scores.of, "campus")
        first = date(2026, 1, 1)

        def measured(days: range) -> int:
            scores = [DayScore(first + timedelta(days=day), 1, 0.5) for day in days]
            store.day_scores.add("campus", RECIPE, {view.seq: scores})
            return steps(store, read)

        measured(range(1))
        few = measured(range(1, 2))
        [matched] = read()
        assert len(matched.days) == 2
        each = (measured(range(2, 30)) - few) * STEP / 28
        assert each < 40  # instructions; 96 with the row of the view
