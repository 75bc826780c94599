"""While a map is described by another recipe, the index by that one is read beside the one that is searched."""

import threading
from contextlib import closing
from datetime import timedelta

import numpy as np
import pytest
import sqlalchemy as sa

from schemas.errors import StorageFailed
from schemas.recipe import DescriptionRecipe
from schemas.records import Changes, Selection
from tests.storage.carried import made
from tests.storage.conftest import Open
from tests.storage.material import NOW, RECIPE, describe_all, enroll, finish, recipe, vector
from worker.search import catalogue as module
from worker.search.catalogue import Catalogue
from worker.search.flat_index import FlatIndex
from worker.storage import checksums
from worker.storage.store import SqlStore
from worker.storage.tables import DESCRIPTIONS

NEXT = recipe("paper")


class Counting:
    """The descriptions of a store, and how many views each read brought."""

    def __init__(self, store: SqlStore) -> None:
        self._store = store
        self.read: list[tuple[int, str]] = []

    def since(self, name: str, revision: int, recipe: DescriptionRecipe | None = None) -> Changes:
        changes = self._store.descriptions.since(name, revision, recipe)
        self.read.append((len(changes.seqs), threading.current_thread().name))
        return changes

    def __getattr__(self, name: str) -> object:
        return getattr(self._store.descriptions, name)


@pytest.fixture
def walk(store: SqlStore) -> SqlStore:
    for number in range(6):
        enroll(store, f"image {number}")
    describe_all(store)
    return store


def contents(store: SqlStore, catalogue: Catalogue) -> dict[int, list[float]]:
    """What a search finds, view by view."""
    index, record = catalogue.index("campus")
    assert index.revision == record.revision == store.maps.revision("campus")
    assert index.recipe == record.description.id
    nowhere = {"semantic": np.zeros(4, np.float32), "detail": np.zeros(4, np.float32)}
    found = index.search(nowhere, 99, Selection(None, np.zeros(0, np.int64)))
    return dict(zip(found.seqs.tolist(), found.distances["detail"].tolist(), strict=True))


def test_the_first_query_after_a_change_reads_only_what_came_last(walk: SqlStore) -> None:
    counting = Counting(walk)
    with closing(Catalogue(walk.maps, counting, FlatIndex.of)) as catalogue:  # type: ignore[arg-type]
        before = contents(walk, catalogue)
        walk.jobs.switch_recipe("campus", NEXT, NOW)
        claims = walk.jobs.claim("worker", 9)
        for claim in claims[:4]:
            finish(walk, claim)
        for _ in range(2):
            assert contents(walk, catalogue) == before
            catalogue.close()
        assert counting.read == [(6, "MainThread"), (4, "revisit-index")]

        for claim in claims[4:]:
            finish(walk, claim)
        after = contents(walk, catalogue)

        assert counting.read[2:] == [(2, "MainThread")]
        assert after == contents(walk, Catalogue(walk.maps, walk.descriptions, FlatIndex.of)) != before
        for claim in claims:
            expected = np.linalg.norm(vector(claim.view, NEXT.description.id)[4:])
            assert after[claim.view.seq] == pytest.approx(expected, rel=1e-6)
        walk.removals.delete_view(claims[0].view.id)
        assert contents(walk, catalogue).keys() == after.keys() - {claims[0].view.seq}


def test_what_is_deleted_or_enrolled_while_it_is_read_ahead_is_seen(
    walk: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "PREPARE_S", 0.0)
    with closing(Catalogue(walk.maps, walk.descriptions, FlatIndex.of)) as catalogue:
        walk.jobs.switch_recipe("campus", NEXT, NOW)
        for number, claim in enumerate(walk.jobs.claim("worker", 6)):
            finish(walk, claim)
            if number == 2:
                enroll(walk, "one more")
            if number == 3:
                walk.removals.delete_view(claim.view.id)
            contents(walk, catalogue)
            catalogue.close()
        describe_all(walk)

        assert walk.maps.get("campus").description == NEXT.description
        found = contents(walk, catalogue)
        assert len(found) == 6
        assert found == contents(walk, Catalogue(walk.maps, walk.descriptions, FlatIndex.of))


def test_a_change_back_is_read_before_it_is_told(walk: SqlStore) -> None:
    """Its views are described already: the map changes over at once."""
    walk.jobs.switch_recipe("campus", NEXT, NOW)
    describe_all(walk)
    counting = Counting(walk)
    catalogue = Catalogue(walk.maps, counting, FlatIndex.of)  # type: ignore[arg-type]
    contents(walk, catalogue)
    catalogue.prepare("campus", recipe("one that nobody stored yet").description)
    catalogue.prepare("campus", RECIPE.description)
    assert [views for views, _ in counting.read] == [6, 0, 6]

    walk.jobs.switch_recipe("campus", RECIPE, NOW)
    found = contents(walk, catalogue)

    assert [views for views, _ in counting.read[3:]] == [0]
    assert found == contents(walk, Catalogue(walk.maps, walk.descriptions, FlatIndex.of))


def test_what_an_earlier_version_described_under_an_older_revision_is_there_too(walk: SqlStore) -> None:
    catalogue = Catalogue(walk.maps, walk.descriptions, FlatIndex.of)
    walk.jobs.switch_recipe("campus", NEXT, NOW)
    first, *others = walk.jobs.claim("worker", 6)
    catalogue.prepare("campus", NEXT.description)
    finish(walk, first)
    with walk._database.writing() as connection:
        of_next = DESCRIPTIONS.c.recipe == NEXT.description.id
        older = {**connection.execute(sa.select(DESCRIPTIONS).where(of_next)).one()._mapping, "revision": 0}
        older |= {"checksum": checksums.of_row(DESCRIPTIONS, older)}
        connection.execute(sa.update(DESCRIPTIONS).where(of_next).values(**older))
    for claim in others:
        finish(walk, claim)

    assert len(contents(walk, catalogue)) == 6


def test_a_map_made_anew_under_the_name_takes_nothing_that_was_read_ahead(walk: SqlStore) -> None:
    catalogue = Catalogue(walk.maps, walk.descriptions, FlatIndex.of)
    walk.jobs.switch_recipe("campus", NEXT, NOW)
    for claim in walk.jobs.claim("worker", 3):
        finish(walk, claim)
    catalogue.prepare("campus", NEXT.description)
    walk.removals.delete_map("campus")
    enroll(walk, "another", by=NEXT, now=NOW + timedelta(seconds=1))
    describe_all(walk)

    assert len(contents(walk, catalogue)) == 1


def test_what_cannot_be_read_ahead_is_said_and_left_to_the_query(
    walk: SqlStore, caplog: pytest.LogCaptureFixture
) -> None:
    class Broken(Counting):
        def since(self, name: str, revision: int, recipe: DescriptionRecipe | None = None) -> Changes:
            if threading.current_thread().name == "revisit-index":
                raise StorageFailed("the disk does not answer")
            return super().since(name, revision, recipe)

    made: list[str] = []

    def make(by: DescriptionRecipe) -> FlatIndex:
        made.append(by.id)
        return FlatIndex.of(by)

    catalogue = Catalogue(walk.maps, Broken(walk), make)  # type: ignore[arg-type]
    walk.jobs.switch_recipe("campus", NEXT, NOW)
    contents(walk, catalogue)
    catalogue.close()
    assert "is not read ahead: " in caplog.text
    describe_all(walk)

    assert len(contents(walk, catalogue)) == 6


def test_a_map_restored_under_its_name_is_another_than_the_one_deleted(walk: SqlStore, reopen: Open) -> None:
    """It was created when that one was: a process that did not delete it would keep the views that are gone."""
    there = reopen()
    path = made(walk)
    with closing(Catalogue(there.maps, there.descriptions, FlatIndex.of)) as catalogue:
        before = contents(there, catalogue)
        walk.removals.delete_map("campus")
        walk.restoring.restore(path, None, NOW)
        after = contents(there, catalogue)
    assert len(after) == len(before) == 6
    assert after.keys().isdisjoint(before)
