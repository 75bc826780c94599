"""Comparing goes on past what is damaged, what cannot be read for a moment, and what changes meanwhile."""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from scenes import scene
from schemas.errors import NotFound, StorageFailed
from schemas.records import Filters, ViewAttributes
from tests.stories.photos import photo
from tests.stories.running import settings
from worker.runtime import Runtime, build
from worker.storage.tables import CELLS


def test_a_damaged_view_is_named_described_again_and_then_compared(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    runtime = build(settings(tmp_path, compare=False))
    runtime.start()
    try:
        for town in ("whole", "damaged"):
            for name in ("mill lane", "rose garden", "castle park"):
                look = photo(scene(name))
                runtime.services.enroll.enroll(look, town, ViewAttributes(place=name), patience_s=60)
        seq = runtime.store.views.list("damaged", Filters())[0][0].seq
        with runtime.store._database.engine.begin() as connection:
            connection.execute(sa.update(CELLS).where(CELLS.c.seq == seq).values(body=b"not cells"))

        with caplog.at_level(logging.ERROR):
            runtime.comparer.all()
            view = runtime.store.views.list("damaged", Filters())[0][0]
            assert f"view {view.id} of map damaged: its cells did not fit the checksum" in caplog.text
            while runtime.store.jobs.count_waiting(redescriptions=True):
                runtime.settlements.wait(view.id, 1)
            runtime.comparer.all()

        assert runtime.store.comparisons.levels("whole").compared == 3
        assert runtime.store.comparisons.levels("damaged").compared == 3
        assert runtime.store.comparisons.uncompared(100, 100) is None
        assert not runtime.comparer.step()
    finally:
        runtime.stop()


@pytest.fixture
def runtime(tmp_path: Path) -> Iterator[Runtime]:
    """A service that compares when it is told to."""
    made = build(settings(tmp_path, compare=False))
    made.start()
    yield made
    made.stop()


def enroll(runtime: Runtime, *towns: str) -> None:
    for town in towns:
        for name in ("mill lane", "rose garden", "castle park"):
            runtime.services.enroll.enroll(photo(scene(name)), town, ViewAttributes(place=name), patience_s=60)


def test_a_view_that_cannot_be_read_for_a_moment_is_compared_later(
    runtime: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    enroll(runtime, "town")
    with monkeypatch.context() as patch:

        def away(*_: Any) -> Any:
            patch.undo()  # it is back for the next view
            raise StorageFailed("away")

        patch.setattr(runtime.store.descriptions, "whole", away)
        with pytest.raises(StorageFailed):
            runtime.comparer.all()
    runtime.comparer.all()
    assert runtime.store.comparisons.levels("town").compared == 3


def test_a_map_that_is_deleted_while_it_is_compared_is_no_error(
    runtime: Runtime, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    enroll(runtime, "town")

    def late(*_: Any) -> Any:  # as an index in the database, of which nothing is left
        runtime.services.maps.delete("town")
        raise NotFound("map", "town")

    monkeypatch.setattr(runtime.comparer._catalogue, "camera_fixed", late)
    with caplog.at_level(logging.ERROR):
        runtime.comparer.all()
    assert caplog.text == ""


def test_views_that_are_being_compared_when_the_ranking_changes_are_compared_by_the_new_one(
    runtime: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else verdicts would rest on scores that no answer has, until the map has doubled."""
    enroll(runtime, "before", "amid")
    runtime.services.maps.change("before", ranking={"mode": "graph"})
    keep = runtime.store.comparisons.keep

    def late(name: str, *of: Any) -> None:
        if name == "amid":
            runtime.services.maps.change("amid", ranking={"mode": "graph"})
        keep(name, *of)

    monkeypatch.setattr(runtime.store.comparisons, "keep", late)
    runtime.comparer.all()
    before, amid = (runtime.store.comparisons.levels(name) for name in ("before", "amid"))
    assert (amid.compared, amid.level, amid.own) == (3, before.level, before.own)
