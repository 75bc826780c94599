"""What PostgreSQL finds by pgvector is what the index in memory finds, whatever becomes of a map's shadows."""

from contextlib import suppress
from datetime import timedelta

import numpy as np
import pytest

from schemas.errors import Conflict, NotFound
from schemas.recipe import MapRecipe
from schemas.records import Filters
from tests.search.test_database_index import (
    Node,
    assert_same,
    attributes,
    describe_all,
    drawn,
    nodes as nodes,  # fixtures
    url as url,
)
from tests.storage.material import NOW, RECIPE, enroll, give_sign, recipe
from worker.storage.store import SqlStore

RECIPES = {one.description.id: one for one in (RECIPE, recipe("paper"), recipe("code-words"))}
CHANGES = ("begin", "begin", "describe", "describe", "compare", "switch", "switch", "discard", "enroll", "delete")


def other(store: SqlStore, draw: np.random.Generator) -> MapRecipe:
    """A recipe that the map does not have."""
    left = [one for name, one in RECIPES.items() if name != store.maps.get("campus").description.id]
    return left[int(draw.integers(len(left)))]


def change(store: SqlStore, what: str, draw: np.random.Generator, number: int) -> None:
    """One change, where the map is in a state for it."""
    with suppress(Conflict, NotFound):
        if what == "begin":
            store.jobs.begin_shadow("campus", other(store, draw), 5, NOW)
        elif what == "describe":
            describe_all(store, draw)
        elif what == "compare":
            describe_all(store, draw)
            give_sign(store, "worker")
            if (claim := store.jobs.claim_map_job("worker", NOW)) is not None:
                store.jobs.finish_shadow(claim, {"wanted": 5, "queries": []}, NOW)
        elif what == "switch":
            change(store, "begin", draw, number)
            change(store, "compare", draw, number)
            store.jobs.switch_to_shadow("campus", NOW)
        elif what == "discard":
            store.jobs.discard_shadow("campus", NOW)
        elif what == "enroll":
            enroll(store, f"more {number}", attributes=attributes(draw), by=RECIPE)
        elif what == "delete":
            views = store.views.list("campus", Filters(), limit=200)[0]
            if len(views) > 3:
                store.removals.delete_view(views[int(draw.integers(len(views)))].id)
    if draw.random() < 0.3:
        while store.pruning.prune():
            pass


@pytest.mark.parametrize("seed", range(6))
def test_shadows_come_go_and_become_the_map(nodes: tuple[Node, Node, Node], seed: int) -> None:
    draw = np.random.default_rng(seed)
    memory, *others = nodes
    for number in range(8):
        enroll(memory.store, f"first {number}", attributes=attributes(draw), now=NOW + timedelta(seconds=number))
    describe_all(memory.store, draw)
    switched, before = 0, memory.store.maps.get("campus").description.id
    for number in range(30):
        change(nodes[int(draw.integers(3))].store, str(draw.choice(CHANGES)), draw, number)
        now = memory.store.maps.get("campus").description.id
        switched, before = switched + (now != before), now
        query, count = drawn(draw), int(draw.integers(1, 9))
        filters = [Filters(), Filters(place="gate"), Filters(exclude_last=2)][int(draw.integers(3))]
        expected = memory.search(query, count, filters)
        for node in others:
            if draw.random() < 0.7:  # else it follows several changes at once
                assert_same(node.search(query, count, filters), expected)
    assert switched >= 2
