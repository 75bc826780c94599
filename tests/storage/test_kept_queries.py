"""What a store keeps of queries that matched nothing."""

from datetime import timedelta
from pathlib import Path

import pytest
import sqlalchemy as sa

from schemas.errors import NotFound
from schemas.inbox import QueryToKeep
from schemas.map_changes import MapChanges
from tests.storage.material import NOW, RECIPE, description, enroll
from worker.storage.database import Database
from worker.storage.finding import Finding
from worker.storage.store import SqlStore
from worker.storage.tables import KEPT_QUERIES


def keep(store: SqlStore, *ids: str, map: str = "campus") -> None:
    for i, query_id in enumerate(ids):
        made, at = description(sum(query_id.encode())), NOW + timedelta(seconds=i)
        store.kept_queries.keep(map, QueryToKeep(query_id, RECIPE.description, made, query_id.encode(), at))


def kept(store: SqlStore, most: int = 100, map: str = "campus") -> list[str]:
    return [query.id for query in store.kept_queries.newest(map, most)[0]]


def test_a_map_keeps_as_many_as_it_is_told_and_drops_the_oldest(store: SqlStore) -> None:
    enroll(store, "gate")
    keep(store, "a")
    assert kept(store) == []
    store.maps.change("campus", MapChanges(keep_queries=3))
    assert store.maps.get("campus").keep_queries == 3
    keep(store, "b", "c", "d", "e")
    assert kept(store) == ["c", "d", "e"]
    assert kept(store, most=2) == ["d", "e"]
    assert store.kept_queries.newest("campus", 2)[1] == 3
    store.maps.change("campus", MapChanges(keep_queries=1))
    assert kept(store) == ["e"]
    store.maps.change("campus", MapChanges(keep_queries=0))
    assert (kept(store), store.maps.get("campus").keep_queries) == ([], 0)
    keep(store, "f", map="moon")


def test_what_is_kept_last_is_the_newest_whatever_the_clock_of_who_answered_says(store: SqlStore) -> None:
    """Ids of queries are made by each process's own clock: one may be behind, or be set back at a start."""
    view = enroll(store, "gate").view
    store.maps.change("campus", MapChanges(keep_queries=3, keep_matches=2))
    keep(store, "f", "g", "h", "b", "a")
    assert kept(store) == ["h", "b", "a"]
    assert kept(store, most=1) == ["a"]
    for query_id in ("5", "6", "2", "1"):
        match(store, query_id, view.seq)
    assert [query_id for query_id, _, _ in matched(store)] == ["2", "1"]
    assert [query.id for query in store.kept_queries.newest("campus", 4, matched=None)[0]] == ["b", "a", "2", "1"]
    store.maps.change("campus", MapChanges(keep_queries=2))
    assert kept(store) == ["b", "a"]


def test_queries_of_before_are_older_than_those_kept_since_and_keep_their_order(
    store: SqlStore, database_url: str
) -> None:
    enroll(store, "gate")
    store.maps.change("campus", MapChanges(keep_queries=4))
    keep(store, "g", "f", "h")
    with store._database.writing() as connection:  # as migration 0022 leaves them, and a version before keeps them
        unnumbered = {"number": 0, "checksum": KEPT_QUERIES.c.checksum}
        connection.execute(sa.update(KEPT_QUERIES).values(**unnumbered))
    keep(store, "b", "a")
    assert kept(store) == ["g", "h", "b", "a"]


def test_what_is_kept_is_what_was_described(store: SqlStore) -> None:
    enroll(store, "gate")
    store.maps.change("campus", MapChanges(keep_queries=3))
    keep(store, "a")
    [query] = store.kept_queries.newest("campus", 3)[0]
    made = description(97)
    assert made.keypoints is not None
    assert query.keypoints is not None
    assert query.vectors.tolist() == [*made.vectors["semantic"], *made.vectors["detail"]]
    assert query.keypoints.descriptors.tolist() == made.keypoints.descriptors.tolist()
    assert (query.recipe, query.queried_at) == (RECIPE.description.id, NOW)
    assert store.kept_queries.image("campus", "a") == b"a"


def test_queries_of_another_map_are_out_of_reach(store: SqlStore) -> None:
    enroll(store, "gate")
    enroll(store, "gate", map="harbour")
    store.maps.change("campus", MapChanges(keep_queries=3))
    keep(store, "a")
    assert store.kept_queries.delete("harbour", ["a"]) == 0
    with pytest.raises(NotFound):
        store.kept_queries.image("harbour", "a")
    assert store.kept_queries.delete("campus", ["a", "b"]) == 1
    with pytest.raises(NotFound):
        store.kept_queries.newest("moon", 1)


def test_a_deleted_map_takes_its_queries_with_it_and_says_how_many(store: SqlStore) -> None:
    enroll(store, "gate")
    enroll(store, "gate", map="harbour")
    for name in ("campus", "harbour"):
        store.maps.change(name, MapChanges(keep_queries=300))
    keep(store, *(f"{i:04}" for i in range(250)))
    keep(store, "x", map="harbour")
    assert store.removals.delete_map("campus").queries == 250
    assert kept(store, map="harbour") == ["x"]


def test_a_damaged_query_is_left_out_and_the_doctor_removes_it(store: SqlStore, database_url: str, data: Path) -> None:
    from worker.storage.examining import examine

    enroll(store, "gate")
    store.maps.change("campus", MapChanges(keep_queries=3))
    keep(store, "a", "b")
    database = Database(database_url)
    with database.writing() as connection:
        values = {"image": b"other bytes", "checksum": KEPT_QUERIES.c.checksum}
        connection.execute(sa.update(KEPT_QUERIES).where(KEPT_QUERIES.c.id == "a").values(**values))
    database.close()

    assert kept(store) == ["b"]
    with pytest.raises(NotFound):
        store.kept_queries.image("campus", "a")
    found: list[Finding] = [one for one in examine(database_url, data) if "kept_queries" in one.where]
    assert [one.where for one in found] == ["row a of kept_queries"]


def test_queries_that_matched_a_view_are_kept_apart_and_go_with_it(store: SqlStore) -> None:
    gate, yard = enroll(store, "gate").view, enroll(store, "yard").view
    match(store, "0", gate.seq)
    assert matched(store) == []
    store.maps.change("campus", MapChanges(keep_matches=2))
    store.maps.change("campus", MapChanges(keep_queries=1))
    keep(store, "a")
    for query_id, view in (("b", gate), ("c", yard), ("d", gate)):
        match(store, query_id, view.seq, 0.25)
    assert (kept(store), matched(store)) == (["a"], [("c", yard.seq, 0.25), ("d", gate.seq, 0.25)])
    record = store.maps.get("campus")
    assert (record.keep_queries, record.keep_matches) == (1, 2)

    store.removals.delete_view(gate.id)
    match(store, "e", gate.seq)  # deleted while it was queried
    assert (kept(store), matched(store)) == (["a"], [("c", yard.seq, 0.25)])
    assert store.removals.delete_map("campus").queries == 2


def match(store: SqlStore, query_id: str, seq: int, score: float = 0.5) -> None:
    made = description(sum(query_id.encode()))
    store.kept_queries.keep("campus", QueryToKeep(query_id, RECIPE.description, made, b"image", NOW, (seq, score)))


def matched(store: SqlStore) -> list[tuple[str, int | None, float | None]]:
    return [(query.id, query.seq, query.score) for query in store.kept_queries.newest("campus", 100, matched=True)[0]]
