"""Filters from columns in memory choose the same views as the database, whatever happens to the map meanwhile."""

import random
import re
import threading
from collections.abc import Sequence
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa
from hypothesis import given, strategies as st

from schemas.errors import InvalidParameters
from schemas.records import Filters, Position, ViewAttributes
from schemas.where import condition
from tests.storage.material import NOW, describe_all, enroll
from worker.storage import filter_cache, filter_columns
from worker.storage.examining import examine
from worker.storage.filter_cache import FilterCache
from worker.storage.listings import selected
from worker.storage.rows import find_map
from worker.storage.store import SqlStore
from worker.storage.tables import MAPS, VIEWS

FILTERS: Sequence[Filters] = [
    Filters(near=(3.0, 0.0, 2.0)),
    Filters(near=(3.0, 0.0, 0.0)),
    Filters(near=(0.0, 0.0, 1e9), geographic=False),
    Filters(after=NOW + timedelta(seconds=3)),
    Filters(after=NOW + timedelta(seconds=3), before=NOW + timedelta(seconds=5, microseconds=-1)),
    Filters(place="hall/4"),
    Filters(place="nowhere"),
    Filters(metadata={"run": "1"}),
    Filters(metadata={"run": "1", "camera": "front"}, near=(0.0, 0.0, 6.0)),
    Filters(metadata={"size": '{"h":2,"w":1.5}'}),
    Filters(metadata={"missing": "1"}),
    Filters(where=condition({"place": {"$prefix": "hall/"}, "metadata.run": {"$gte": 1}})),
    Filters(where=condition({"x": {"$lt": 4}}), exclude_last=6),
]


def attributes(number: int) -> ViewAttributes:
    extra = {"size": {"w": 1.5, "h": 2}} if number == 2 else {}
    return ViewAttributes(
        f"{'hall' if number % 2 == 0 else 'Hall'}/{number}",
        Position(x=float(number), y=0.0),
        NOW + timedelta(seconds=number),
        {"run": number % 3, "camera": "front" if number < 5 else "rear", **extra},
    )


@pytest.fixture
def walk(store: SqlStore) -> SqlStore:
    for number in range(9):
        enroll(store, f"image {number}", attributes=attributes(number))
    describe_all(store)
    store.listings._columns = cache(store)
    return store


Chosen = tuple[list[int] | None, list[int]]


def by_database(store: SqlStore, filters: Filters) -> Chosen:
    """What the database chooses, whatever is in memory."""
    kept, store.listings._columns = store.listings._columns, cache(store, settled_s=1e9)
    try:
        return chosen(store, filters)
    finally:
        store.listings._columns = kept


def chosen(store: SqlStore, filters: Filters) -> Chosen:
    selection = store.listings.select("campus", filters)
    store.listings._columns.wait()
    return None if selection.only is None else selection.only.tolist(), selection.never.tolist()


def cache(store: SqlStore, **options: Any) -> FilterCache:
    return FilterCache(store._database, **{"settled_s": 0.0, **options})


@pytest.mark.parametrize("looked_for", ["Caf\u00e9", "Cafe\u0301"])
@pytest.mark.parametrize("kept", ["Caf\u00e9", "Cafe\u0301"])
def test_a_place_is_found_however_accents_are_written_here_and_there(
    store: SqlStore, kept: str, looked_for: str
) -> None:
    """Names given before they were composed are kept as they were."""
    there = enroll(store, "terrace", attributes=ViewAttributes(kept)).view
    enroll(store, "kitchen", attributes=ViewAttributes("Kitchen"))
    describe_all(store)

    store.listings._columns = cache(store)

    assert store.views.get(there.id).attributes.place == "Caf\u00e9"
    assert not enroll(store, "terrace", attributes=ViewAttributes("Caf\u00e9")).created
    for _ in range(2):  # by the database, and by what is in memory then
        assert chosen(store, Filters(place=looked_for)) == ([there.seq], [])
    assert by_database(store, Filters(place=looked_for)) == ([there.seq], [])


def test_memory_and_database_choose_the_same_and_memory_is_bounded(walk: SqlStore) -> None:
    expected = [by_database(walk, filters) for filters in FILTERS]
    for filters, of_database in zip(FILTERS, expected, strict=True):
        walk.listings._columns = cache(walk)
        assert chosen(walk, filters) == chosen(walk, filters) == of_database
        assert walk.listings._columns.size > 0
    walk.listings._columns = small = cache(walk, most_bytes=2000)  # what does not fit is left to the database
    for _ in range(3):
        assert [chosen(walk, filters) for filters in FILTERS] == expected
        assert small.size <= 2000


def test_near_on_the_globe_is_the_same_from_memory(store: SqlStore) -> None:
    for number, longitude in enumerate((179.9, -179.9, 170.0, 0.0)):
        enroll(store, f"image {number}", attributes=ViewAttributes(None, Position(lat=10.0, lon=longitude)))
    store.listings._columns = cache(store)
    for near in ((10.0, 180.0, 20_000.0), (10.0, 0.0, 0.0), (-10.0, 0.0, 3e7), (89.0, 5.0, 9e6)):
        expected = by_database(store, Filters(near=near))
        assert chosen(store, Filters(near=near)) == chosen(store, Filters(near=near)) == expected
    for _ in range(3):
        with pytest.raises(InvalidParameters, match="latitude"):
            store.listings.select("campus", Filters(near=(91.0, 0.0, 5.0)))


def test_a_map_that_grows_is_followed_and_read_once(walk: SqlStore, monkeypatch: pytest.MonkeyPatch) -> None:
    for filters in FILTERS:
        chosen(walk, filters)
    columns = walk.listings._columns
    from_memory: list[bool] = []
    of_columns = columns.only

    def only(*of: Any) -> Any:
        found = of_columns(*of)
        from_memory.append(found is not None)
        return found

    monkeypatch.setattr(columns, "only", only)
    monkeypatch.setattr(columns, "_begin_reading", lambda *of: pytest.fail("all is read anew"))
    for number in range(9, 14):
        enroll(walk, f"image {number}", attributes=replace(attributes(number), place=f"{'ab yz'[number - 9]}/{number}"))
        if number % 2:
            describe_all(walk)
        else:
            walk.removals.delete_view(walk.views.list("campus", Filters())[0][number % 5].id)
        found = [chosen(walk, filters) for filters in FILTERS]
        assert all(from_memory)
        assert found == [by_database(walk, filters) for filters in FILTERS]


def test_a_transaction_from_before_an_enrolment_sees_nothing_of_it(walk: SqlStore) -> None:
    """What is enrolled gets no revision before it is described."""
    filters = FILTERS[3]
    chosen(walk, filters)
    with walk._database.reading() as older:
        of = find_map(older, "campus")
        before = selected(older, of.id, filters).only
        enroll(walk, "one more", attributes=attributes(9))
        found, _ = chosen(walk, filters)
        assert before is not None
        assert found is not None
        assert len(found) == len(before) + 1
        only = walk.listings._columns.only(older, of, filters)
        assert only is None or only.tolist() == before.tolist()


def test_whoever_writes_meanwhile_each_transaction_gets_what_its_own_snapshot_holds(walk: SqlStore) -> None:
    columns = cache(walk)
    done, from_memory, wrong = threading.Event(), [0, 0], list[object]()

    def read(seed: int) -> None:
        chance = random.Random(seed)
        while not done.is_set():
            filters = replace(chance.choice(FILTERS), exclude_last=None)
            with walk._database.reading() as connection:
                of = find_map(connection, "campus")
                found, expected = columns.only(connection, of, filters), selected(connection, of.id, filters).only
            from_memory[found is not None] += 1
            if found is not None and found.tolist() != (expected.tolist() if expected is not None else None):
                wrong.append((filters, found, expected))

    readers = [threading.Thread(target=read, args=(seed,)) for seed in range(3)]
    for reader in readers:
        reader.start()
    for number in range(9, 60):
        enroll(walk, f"image {number}", attributes=attributes(number % 30))
        if number % 3 == 0:
            describe_all(walk)
        elif number % 5 == 0:
            walk.removals.delete_view(walk.views.list("campus", Filters())[0][0].id)
        elif number == 40:
            changed(walk)
    done.set()
    for reader in readers:
        reader.join()
    assert wrong == []
    assert min(from_memory) > 0


def test_a_map_that_grew_much_is_read_anew_and_queries_never_wait(
    walk: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(filter_cache, "MOST_FURTHER", 1)
    chosen(walk, FILTERS[0])
    for number in range(9, 13):
        enroll(walk, f"image {number}", attributes=attributes(number))
        if number > 9:
            assert chosen(walk, FILTERS[0]) == chosen(walk, FILTERS[0]) == by_database(walk, FILTERS[0])
    assert walk.listings._columns.size > 0


def test_a_map_whose_views_keep_changing_is_left_to_the_database(store: SqlStore) -> None:
    enroll(store, "image", attributes=attributes(1))
    store.listings._columns = settling = cache(store, settled_s=1e9)
    for _ in range(3):
        changed(store)
        assert chosen(store, FILTERS[0]) == chosen(store, FILTERS[0]) == by_database(store, FILTERS[0])
        assert settling.size == 0


def test_what_an_earlier_version_changed_beside_is_seen_in_the_end(walk: SqlStore) -> None:
    walk.listings._columns = cache(walk, kept_s=0.0)
    chosen(walk, FILTERS[0])
    with walk._database.writing() as connection:  # without saying so
        connection.execute(sa.update(VIEWS).values(x=3.0, checksum=VIEWS.c.checksum))
    for _ in range(2):
        assert chosen(walk, FILTERS[0]) == by_database(walk, FILTERS[0])


def test_damaged_revisions_are_found_and_mended_and_leave_the_database_to_choose(
    walk: SqlStore, database_url: str, data: Path
) -> None:
    for wrong in (-1, 1 << 40):
        chosen(walk, FILTERS[0])
        with walk._database.writing() as connection:
            connection.execute(sa.update(MAPS).values(edited=wrong, checksum=MAPS.c.checksum))
        assert chosen(walk, FILTERS[0]) == chosen(walk, FILTERS[0]) == by_database(walk, FILTERS[0])
        [finding] = examine(database_url, data, running=True)
        assert re.search(r"map 'campus': its revisions \d+, \d+ and -?\d+ cannot be", str(finding))
        with walk._database.writing() as connection:
            assert finding.mend is not None
            finding.mend(connection)
        assert list(examine(database_url, data, running=True)) == []
        assert chosen(walk, FILTERS[0]) == chosen(walk, FILTERS[0]) == by_database(walk, FILTERS[0])


FIELDS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.floats(-2, 2),
    st.sampled_from(["", "a", "ab", "b", "\u00e9", "z"]),
    st.lists(st.integers(), max_size=1),
)


@given(st.lists(FIELDS, max_size=6), st.lists(FIELDS, max_size=6), st.lists(st.booleans(), min_size=12, max_size=12))
def test_a_column_that_grew_and_shrank_is_that_of_what_is_left(
    known: list[object], further: list[object], left: list[bool]
) -> None:
    every = [*known, *further]
    gone = np.array(left[: len(every)], np.bool_)
    grown = filter_columns._mixed(known).with_further(filter_columns._mixed(further)).without(gone)
    whole = filter_columns._mixed([one for one, out in zip(every, gone.tolist(), strict=True) if not out])

    assert grown.exists.tolist() == whole.exists.tolist()
    for value in (True, False, 0, 1.5, "", "a", "ab", "\u00e9", "none of them"):
        assert grown.equal(value).tolist() == whole.equal(value).tolist()
    for prefix in ("", "a", "b", "\u00e9", "y"):
        assert grown.begins(prefix).tolist() == whole.begins(prefix).tolist()
    assert grown.compared("$gte", 0.5).tolist() == whole.compared("$gte", 0.5).tolist()


def changed(store: SqlStore) -> None:
    first = store.views.list("campus", Filters())[0][0]
    store.views.change(first.id, lambda known: replace(known, position=Position(x=3.5, y=0.0), metadata={"run": 1}))


def deleted(store: SqlStore) -> None:
    store.removals.delete_views("campus", Filters(place="hall/4"))


def grown(store: SqlStore) -> None:
    enroll(store, "one more", attributes=replace(attributes(4), place="hall/9"))


def described(store: SqlStore) -> None:
    describe_all(store)


def enrolled_again_after_damage(store: SqlStore) -> None:
    """What is sent again is what there is, under the number that it had."""
    with store._database.writing() as connection:
        lost = sa.update(VIEWS).where(VIEWS.c.place == "Hall/5").values(place="Hall/6")
        connection.execute(lost.values(checksum=VIEWS.c.checksum))
    store.views.list("campus", Filters())
    enroll(store, "image 5", attributes=replace(attributes(5), place="hall/5"))
    describe_all(store)


def pending_deleted(store: SqlStore) -> None:
    pending = enroll(store, "yet one more", attributes=replace(attributes(4), place="hall/10")).view
    for _ in range(2):
        chosen(store, FILTERS[0])
    store.removals.delete_view(pending.id)


def made_anew(store: SqlStore) -> None:
    store.removals.delete_map("campus")
    enroll(store, "another", attributes=attributes(3))


def test_what_happens_to_a_map_is_seen_by_the_next_filter(walk: SqlStore) -> None:
    for happens in (
        changed,
        deleted,
        grown,
        described,
        enrolled_again_after_damage,
        pending_deleted,
        made_anew,
    ):
        for _ in range(2):
            for filters in FILTERS:
                chosen(walk, filters)

        happens(walk)

        now = [chosen(walk, filters) for filters in FILTERS]
        again = [chosen(walk, filters) for filters in FILTERS]
        assert now == again == [by_database(walk, filters) for filters in FILTERS], happens.__name__
