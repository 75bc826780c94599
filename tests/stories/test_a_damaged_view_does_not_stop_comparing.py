"""A damaged description keeps its view from being compared until it is described again, and nothing else waits."""

import logging
from pathlib import Path

import pytest
import sqlalchemy as sa

from scenes import scene
from schemas.records import Filters, ViewAttributes
from tests.stories.photos import photo
from tests.stories.running import settings
from worker.runtime import build
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
