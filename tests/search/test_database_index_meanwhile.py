"""What PostgreSQL searches while its vectors are added and others change the map."""

from typing import Any

import numpy as np
import pytest
import sqlalchemy as sa

from schemas.records import Filters
from tests.search.test_database_index import (
    Node,
    assert_same,
    describe_all,
    drawn,
    nodes as nodes,  # fixtures
    url as url,
)
from tests.storage.material import enroll
from worker.storage import vector_filling


def test_views_that_are_deleted_while_their_vectors_are_added_are_left_out(
    nodes: tuple[Node, Node, Node], monkeypatch: pytest.MonkeyPatch
) -> None:
    memory, database, _ = nodes
    draw = np.random.default_rng(0)
    views = [enroll(memory.store, f"first {number}").view for number in range(4)]
    describe_all(memory.store, draw)
    add, going = vector_filling._add, [views[1].id, views[2].id]

    def late(*of: Any) -> None:
        if going:
            memory.store.removals.delete_view(going.pop())
        add(*of)

    monkeypatch.setattr(vector_filling, "_add", late)
    vectors = drawn(draw)
    found = database.search(vectors, 5, Filters())
    assert going == []
    assert set(found.seqs.tolist()) == {views[0].seq, views[3].seq}
    assert_same(memory.search(vectors, 5, Filters()), found)


def test_a_connection_that_is_cut_while_vectors_are_added_is_made_anew(
    nodes: tuple[Node, Node, Node], monkeypatch: pytest.MonkeyPatch
) -> None:
    memory, database, _ = nodes
    draw = np.random.default_rng(0)
    enroll(memory.store, "gate")
    describe_all(memory.store, draw)
    add = vector_filling._add
    cut: list[int] = []

    def broken(connection: sa.Connection, *of: Any) -> None:
        if not cut:
            cut.append(connection.scalar(sa.text("SELECT pg_backend_pid()")))
            with memory.store._database.reading() as other:
                other.execute(sa.text("SELECT pg_terminate_backend(:pid)"), {"pid": cut[0]})
        add(connection, *of)

    monkeypatch.setattr(vector_filling, "_add", broken)
    vectors = drawn(draw)
    assert_same(memory.search(vectors, 5, Filters()), database.search(vectors, 5, Filters()))
    assert len(cut) == 1


def test_nothing_is_known_any_more_of_maps_that_were_deleted_elsewhere(nodes: tuple[Node, Node, Node]) -> None:
    _, database, other = nodes
    draw = np.random.default_rng(0)
    for _ in range(3):
        enroll(other.store, "gate")
        describe_all(other.store, draw)
        assert database.search(drawn(draw), 1, Filters()).searched == 1
        other.store.removals.delete_map("campus")
    vectors = database.store.vectors
    assert vectors is not None
    assert len(vectors._members._known) == 1
