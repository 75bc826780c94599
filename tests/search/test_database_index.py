"""What PostgreSQL finds by pgvector is what the index in memory finds, whoever changed the map."""

from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa

from schemas.description import Floats
from schemas.errors import InvalidParameters, NotFound, SetupError
from schemas.records import Candidates, Filters, Position, Selection, ViewAttributes
from schemas.where import condition
from tests.storage.databases import data_folder, postgres_schema, sqlite_url
from tests.storage.material import NOW, RECIPE, description, enroll, recipe
from worker.method.cascade import ViewGone
from worker.search.choosing import Kind, make_catalogue
from worker.storage import vector_filling, vector_hnsw, vector_search, vector_tables
from worker.storage.examining_vectors import vector_findings
from worker.storage.migrating import migrate, newest
from worker.storage.store import SqlStore, open_store
from worker.storage.vector_tables import SEARCHED_VECTORS

PAPER = recipe("paper")
CONDITION = '{"metadata.floor": {"$gte": 1}, "$not": {"x": {"$lt": 3}}}'
NOTHING = np.zeros(0, np.int64)
CHANNELS = tuple(RECIPE.description.parameters.channels)


@pytest.fixture
def url() -> Iterator[str]:
    """A schema of its own in a database that has the extension beside it, in `public`."""
    with postgres_schema() as url:
        engine = sa.create_engine(sa.make_url(url).difference_update_query(["options"]))
        with engine.begin() as connection:
            connection.execute(sa.text("CREATE EXTENSION IF NOT EXISTS vector SCHEMA public"))
        engine.dispose()
        yield url


@pytest.fixture
def nodes(url: str) -> Iterator[tuple["Node", "Node", "Node"]]:
    """Three nodes on one database: in memory, and twice in the database."""
    with ExitStack() as stack:
        folders = [stack.enter_context(data_folder()) for _ in range(3)]
        kinds: tuple[Kind, ...] = ("faiss", "pgvector", "pgvector")
        made = [Node(url, folder, kind) for folder, kind in zip(folders, kinds, strict=True)]
        for node in made:
            stack.enter_context(closing(node.store))
        yield made[0], made[1], made[2]


class Node:
    """A store and its catalogue, as one process has them."""

    def __init__(self, url: str, folder: Path, kind: Kind) -> None:
        self.store: SqlStore = open_store(url, folder, index=kind)
        self.catalogue, self.selecting = make_catalogue(self.store, kind)

    def search(self, vectors: dict[str, Floats], count: int, filters: Filters, *never: int) -> Candidates:
        index, record = self.catalogue.index("campus")
        assert (index.recipe, index.revision) == (record.description.id, record.revision)
        selection = replace(self.selecting.select("campus", filters), never=np.array(sorted(never), np.int64))
        if selection.filters is None and filters != Filters():
            chosen = self.selecting.select("campus", filters)
            selection = replace(chosen, never=np.union1d(chosen.never, selection.never))
        return index.search(vectors, count, selection)


def drawn(draw: np.random.Generator) -> dict[str, Floats]:
    """Vectors of one view; few enough values that many views tie."""
    return {channel: (draw.integers(0, 3, 4) / 4).astype(np.float32) for channel in CHANNELS}


def describe_all(store: SqlStore, draw: np.random.Generator) -> None:
    while claims := store.jobs.claim("worker", 10):
        for claim in claims:
            made = replace(description(int(draw.integers(99))), vectors=drawn(draw))
            store.jobs.finish(claim, made, NOW)


def attributes(draw: np.random.Generator) -> ViewAttributes:
    return ViewAttributes(
        str(draw.choice(["gate", "pond"])),
        Position(x=float(draw.integers(9)), y=float(draw.integers(9))),
        NOW + timedelta(minutes=int(draw.integers(9))),
        {"floor": int(draw.integers(3))},
    )


def assert_same(one: Candidates, other: Candidates) -> None:
    assert (one.revision, one.searched) == (other.revision, other.searched)
    np.testing.assert_array_equal(one.seqs, other.seqs)
    np.testing.assert_array_equal(one.order, other.order)
    for channel in one.ranks:
        np.testing.assert_array_equal(one.ranks[channel], other.ranks[channel], err_msg=channel)
        np.testing.assert_array_equal(one.distances[channel], other.distances[channel], err_msg=channel)


@pytest.mark.parametrize("seed", range(4))
def test_the_database_finds_what_memory_finds_after_every_change(nodes: tuple[Node, Node, Node], seed: int) -> None:
    draw = np.random.default_rng(seed)
    memory, *others = nodes
    writers = [node.store for node in nodes]

    def some_ids() -> list[str]:
        return [view.id for view in memory.store.views.list("campus", Filters(), limit=200)[0]]

    for number in range(12):
        enroll(memory.store, f"first {number}", attributes=attributes(draw), now=NOW + timedelta(seconds=number))
    describe_all(memory.store, draw)
    for number in range(14):
        store = writers[int(draw.integers(3))]
        change = draw.choice(["enroll", "enroll", "delete", "switch", "back", "again", "wait"])
        if change == "enroll":
            for more in range(int(draw.integers(1, 5))):
                enroll(store, f"{number} {more}", attributes=attributes(draw), by=RECIPE)
            if draw.random() < 0.8:  # else they wait to be described, and are not found
                describe_all(store, draw)
        elif change == "delete" and len(some_ids()) > 3:
            store.removals.delete_view(str(draw.choice(some_ids())))
        elif change in ("switch", "back"):
            describe_all(store, draw)
            store.jobs.switch_recipe("campus", PAPER if change == "switch" else RECIPE, NOW)
            describe_all(store, draw)
        elif change == "again" and draw.random() < 0.3:  # another map of the same name
            store.removals.delete_map("campus")
            enroll(store, "anew", attributes=attributes(draw), now=NOW + timedelta(hours=number + 1))
            describe_all(store, draw)

        known = some_ids()
        assert len({node.catalogue.index("campus")[0].sample() for node in nodes}) == 1
        all_filters = [
            Filters(),
            Filters(near=(4.0, 4.0, float(draw.integers(1, 5)))),
            Filters(after=NOW + timedelta(minutes=3), before=NOW + timedelta(minutes=6)),
            Filters(place="gate"),
            Filters(metadata={"floor": "1"}),
            Filters(where=condition(CONDITION)),
            Filters(exclude_last=int(draw.integers(4))),
            Filters(exclude_last=timedelta(seconds=5)),
            Filters(place="pond", exclude=tuple(known[:2]), exclude_last=1),
        ]
        filters = all_filters[int(draw.integers(len(all_filters)))]
        never = [memory.store.views.get(view_id).seq for view_id in known[:: int(draw.integers(3, 6))]]
        query, count = drawn(draw), int(draw.integers(1, 9))
        if draw.random() < 0.3:
            del query[CHANNELS[0]]
        expected = memory.search(query, count, filters, *never)
        for node in others:
            assert_same(node.search(query, count, filters, *never), expected)
        if draw.random() < 0.5:
            expected = memory.search(query, 200, Filters())
            assert_same(others[0].search(query, 200, Filters()), expected)


def test_a_map_is_filled_in_portions_and_as_of_its_revision(
    nodes: tuple[Node, Node, Node], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(vector_filling, "ROWS", 4)
    draw = np.random.default_rng(1)
    memory, one, other = nodes
    for number in range(11):
        enroll(memory.store, str(number))
    describe_all(memory.store, draw)

    query = drawn(draw)
    for node in (one, other):
        assert_same(node.search(query, 3, Filters()), memory.search(query, 3, Filters()))
    assert one.catalogue.revisions() == {"campus": memory.store.maps.revision("campus")}


def test_what_is_refused_in_memory_is_refused_inside_the_search(nodes: tuple[Node, Node, Node]) -> None:
    _, node, _ = nodes
    enroll(node.store, "gate")
    describe_all(node.store, np.random.default_rng(0))
    with pytest.raises(InvalidParameters, match="typo"):
        node.search(drawn(np.random.default_rng(0)), 1, Filters(exclude=("typo",)))
    with pytest.raises(NotFound):
        node.catalogue.index("museum")


def test_the_index_of_a_map_that_was_deleted_is_gone(nodes: tuple[Node, Node, Node]) -> None:
    _, node, other = nodes
    draw = np.random.default_rng(0)
    enroll(node.store, "gate")
    describe_all(node.store, draw)
    index, _ = node.catalogue.index("campus")

    other.store.removals.delete_map("campus")

    with pytest.raises(NotFound):
        index.search(drawn(draw), 1, Selection(None, NOTHING))
    enroll(node.store, "pond")
    describe_all(node.store, draw)
    with pytest.raises(ViewGone):
        index.search(drawn(draw), 1, Selection(None, NOTHING))
    assert node.search(drawn(draw), 1, Filters()).searched == 1


def test_an_index_outlives_views_that_come_and_go_after_it_was_taken(nodes: tuple[Node, Node, Node]) -> None:
    _, node, other = nodes
    draw = np.random.default_rng(0)
    first = enroll(node.store, "gate").view
    enroll(node.store, "pond")
    describe_all(node.store, draw)
    index, record = node.catalogue.index("campus")

    other.store.removals.delete_view(first.id)

    found = index.search(drawn(draw), 5, Selection(None, NOTHING))
    assert first.seq not in found.seqs.tolist()
    assert found.revision >= record.revision


def test_a_damaged_vector_is_left_out_and_described_again(nodes: tuple[Node, Node, Node]) -> None:
    _, node, other = nodes
    draw = np.random.default_rng(0)
    views = [enroll(node.store, name).view for name in ("gate", "pond", "stairs")]
    describe_all(node.store, draw)

    def damage(seq: int) -> None:
        with node.store.maps._database.writing() as connection:
            connection.execute(sa.text("UPDATE vectors SET body = '\\x00' WHERE seq = :seq"), {"seq": seq})

    damage(views[0].seq)  # before it was searched
    assert views[0].seq not in node.search(drawn(draw), 5, Filters()).seqs.tolist()
    damage(views[1].seq)  # after
    assert node.search(drawn(draw), 5, Filters()).seqs.tolist() == [views[2].seq]
    assert node.store.jobs.count_pending("campus") == 2
    describe_all(other.store, draw)
    assert node.search(drawn(draw), 5, Filters()).searched == 3


def test_hnsw_is_built_measured_and_fills_what_filters_leave(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vector_hnsw, "LEAST_VIEWS", 40)
    draw = np.random.default_rng(0)
    with data_folder() as folder, data_folder() as second:
        node, exact = Node(url, folder, "pgvector-hnsw"), Node(url, second, "pgvector")
        with closing(node.store), closing(exact.store):
            for number in range(60):
                enroll(node.store, str(number), attributes=attributes(draw))
            describe_all(node.store, draw)
            assert node.store.indexing is not None
            assert not node.store.indexing.step(now_s=0.0)  # nothing was searched yet
            node.search(drawn(draw), 5, Filters())
            assert node.catalogue.recalls() == {}

            assert node.store.indexing.step(now_s=100.0)
            assert not node.store.indexing.step(now_s=200.0)

            recall = node.catalogue.recalls()["campus"]
            assert 0.8 <= recall <= 1
            with node.store.maps._database.reading() as connection:
                names = sa.inspect(connection).get_indexes(SEARCHED_VECTORS.name)
            assert len([one for one in names if str(one["name"]).startswith("searched_hnsw_")]) == len(CHANNELS)
            for filters in (
                Filters(),
                Filters(place="gate"),
                Filters(metadata={"floor": "2"}),
                Filters(exclude_last=58),
            ):
                query = drawn(draw)
                found, expected = node.search(query, 5, filters), exact.search(query, 5, filters)
                assert (found.searched, found.revision) == (expected.searched, expected.revision)
                for channel in CHANNELS:
                    assert np.count_nonzero(found.ranks[channel]) == np.count_nonzero(expected.ranks[channel])

            node.store.removals.delete_map("campus")
            enroll(node.store, "anew")
            assert not node.store.indexing.step(now_s=300.0)
            with node.store.maps._database.reading() as connection:
                names = sa.inspect(connection).get_indexes(SEARCHED_VECTORS.name)
            assert not [one for one in names if str(one["name"]).startswith("searched_hnsw_")]


def test_only_the_approximate_search_reads_the_hnsw_index(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vector_hnsw, "LEAST_VIEWS", 40)
    draw = np.random.default_rng(0)
    with data_folder() as folder:
        node = Node(url, folder, "pgvector-hnsw")
        with closing(node.store):
            for number in range(60):
                enroll(node.store, str(number), attributes=attributes(draw))
            describe_all(node.store, draw)
            node.search(drawn(draw), 5, Filters())
            assert node.store.indexing is not None
            assert node.store.indexing.step(now_s=100.0)
            with node.store.maps._database.reading() as connection:
                held = connection.execute(sa.select(vector_tables.SEARCHED_MAPS)).one()
                vector = drawn(draw)[next(iter(CHANNELS))]
                scope = vector_search.Scope(held.id, 0, len(vector), [], on_views=False)
                vector_tables.see_extension(connection)
                for way in ("seqscan", "sort"):  # sixty rows are read sooner without an index
                    connection.execute(sa.text(f"SET LOCAL enable_{way} = off"))

                def plan(approximate: bool) -> str:
                    statements: list[tuple[str, Any]] = []

                    def note(*of: Any) -> None:
                        statements.append(of[2:4])

                    sa.event.listen(connection, "before_cursor_execute", note)
                    assert len(vector_search.nearest(connection, scope, vector, 5, approximate=approximate)) == 5
                    sa.event.remove(connection, "before_cursor_execute", note)
                    statement, parameters = statements[-1]
                    return "\n".join(connection.exec_driver_sql(f"EXPLAIN {statement}", parameters).scalars())

                assert "Index Scan using searched_hnsw_" in plan(approximate=True)
                assert "searched_hnsw_" not in plan(approximate=False)


def test_a_database_that_cannot_search_vectors_is_refused_in_words() -> None:
    with data_folder() as folder, pytest.raises(SetupError, match=r"file of SQLite; set REVISIT_DATABASE"):
        open_store(sqlite_url(folder), folder, index="pgvector")


def test_a_schema_beside_that_of_the_extension_has_tables_of_its_own(url: str, nodes: tuple[Node, Node, Node]) -> None:
    public, alone = sa.make_url(url).difference_update_query(["options"]), {"poolclass": sa.NullPool}
    engine = sa.create_engine(public, isolation_level="AUTOCOMMIT", **alone)
    schema = str(sa.make_url(url).query["options"]).partition("=")[2]
    with engine.connect() as connection, postgres_schema() as other, data_folder() as folder:
        connection.execute(sa.text(f"ALTER EXTENSION vector SET SCHEMA {schema}"))
        try:
            with closing(Node(other, folder, "pgvector").store), sa.create_engine(other, **alone).connect() as seeing:
                assert sa.inspect(seeing).has_table(SEARCHED_VECTORS.name)
        finally:
            connection.execute(sa.text("ALTER EXTENSION vector SET SCHEMA public"))


def test_a_server_without_the_extension_is_refused_in_words(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("worker.storage.vector_tables.EXTENSION", "vector_of_another_name")
    with data_folder() as folder, pytest.raises(SetupError, match=r"does not offer the extension pgvector; install"):
        open_store(url, folder, index="pgvector")


def test_an_old_extension_is_refused_in_words(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("worker.storage.vector_tables.OLDEST", (99, 0, 0))
    with data_folder() as folder, pytest.raises(SetupError, match=r"or newer is needed, and the database has 0\."):
        open_store(url, folder, index="pgvector")


def test_a_user_who_may_not_make_the_extension_is_told_who_may(url: str) -> None:
    name = f"reader_{np.random.default_rng().integers(10**9)}"
    plain = sa.make_url(url)
    engine = sa.create_engine(plain)
    schema = str(plain.query["options"]).rpartition("=")[2]
    with engine.begin() as connection:
        connection.execute(sa.text(f"CREATE ROLE {name} LOGIN"))
        connection.execute(sa.text(f"GRANT USAGE ON SCHEMA {schema} TO {name}"))
    try:
        with data_folder() as folder:
            open_store(url, folder).close()
            with engine.begin() as connection:
                connection.execute(sa.text(f"GRANT SELECT ON ALL TABLES IN SCHEMA {schema} TO {name}"))
            theirs = plain.set(username=name).render_as_string(hide_password=False)
            with pytest.raises(SetupError, match=r"may not .*have an owner of the database do it once"):
                open_store(theirs, folder, index="pgvector")
    finally:
        with engine.begin() as connection:
            connection.execute(sa.text(f"DROP OWNED BY {name}; DROP ROLE {name}"))
        engine.dispose()


def test_the_doctor_says_what_the_database_lacks_to_search(nodes: tuple[Node, Node, Node], url: str) -> None:
    _, node, _ = nodes
    draw = np.random.default_rng(0)
    for name in ("gate", "pond"):
        enroll(node.store, name)
    describe_all(node.store, draw)
    node.search(drawn(draw), 1, Filters())
    assert vector_findings(url, approximate=False) == ("exact in PostgreSQL", [])
    assert node.store.vectors is not None
    assert node.store.vectors.check() == "ok"

    with node.store.maps._database.writing() as connection:
        connection.execute(sa.text("DELETE FROM searched_vectors WHERE seq = (SELECT max(seq) FROM searched_vectors)"))
        connection.execute(sa.text("UPDATE searched_maps SET recall = 0.5, measured_views = 2"))
    [lacking] = vector_findings(url, approximate=False)[1]
    assert "searches 2 vectors of 4" in str(lacking)
    assert "finds 50.0% of the nearest" in str(vector_findings(url, approximate=True)[1][-1])

    with node.store.maps._database.writing() as connection:  # as the finding says
        connection.execute(sa.text(lacking.remedy.split("`")[1]))
    assert node.search(drawn(draw), 5, Filters()).searched == 2
    assert vector_findings(url, approximate=True)[1] == []


def test_migrating_makes_the_tables_and_a_file_of_sqlite_is_a_finding(url: str) -> None:
    with data_folder() as folder:
        assert migrate(url, folder, "pgvector") == newest()
        assert vector_findings(url, approximate=False)[1] == []
        [finding] = vector_findings(sqlite_url(folder), approximate=False)[1]
        assert "file of SQLite" in str(finding)
