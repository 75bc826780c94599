"""Writers wait for each other, but not for long: neither for one that writes on, nor for one that fell silent."""

import threading
import time
from contextlib import closing
from pathlib import Path

import pytest

from schemas.errors import StorageFailed
from schemas.inbox import QueryToKeep
from schemas.map_changes import MapChanges
from tests.storage.conftest import Open
from tests.storage.databases import postgres_schema
from tests.storage.material import NOW, RECIPE, description, enroll
from worker.storage import dialect
from worker.storage.database import Database
from worker.storage.kept_queries import PATIENCE_S
from worker.storage.store import open_store


def test_a_writer_that_waits_too_long_is_told_that_others_write(
    reopen: Open, database_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual_s = dialect.BUSY_S
    monkeypatch.setattr(dialect, "BUSY_S", 0.3)
    store = reopen()
    others = Database(database_url)
    with others.writing():
        began = time.monotonic()
        with pytest.raises(StorageFailed, match="being written by others"):
            enroll(store, "gate")
        assert 0.2 < time.monotonic() - began < usual_s / 2
    others.close()
    enroll(store, "gate")


def test_a_query_that_is_to_be_kept_waits_a_second_for_others_and_enrolments_as_long_as_before(
    reopen: Open, database_url: str
) -> None:
    store = reopen()
    enroll(store, "gate")
    store.maps.change("campus", MapChanges(keep_queries=5))

    def keep() -> None:
        store.kept_queries.keep("campus", QueryToKeep("q", RECIPE.description, description(1), b"image", NOW))

    others = Database(database_url)
    with others.writing():
        began = time.monotonic()
        with pytest.raises(StorageFailed, match="being written by others"):
            keep()
        assert time.monotonic() - began < dialect.BUSY_S / 2
        assert store.check_space() == "ok"  # for which nothing is tried: the service is sound
        waiting = threading.Thread(target=enroll, args=(store, "hall"))
        waiting.start()
        time.sleep(2 * PATIENCE_S)
        assert waiting.is_alive()
    waiting.join()
    others.close()
    assert store.maps.counts("campus").views["pending"] == 2
    keep()
    assert store.kept_queries.newest("campus", 5)[1] == 1


def test_a_writer_that_falls_silent_is_passed_and_told(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As when its machine is suspended, or cut off from the network; the writers of a file are on one machine."""
    stopped, wake, told = threading.Event(), threading.Event(), []
    with postgres_schema() as url, closing(open_store(url, data)) as store, closing(Database(url)) as silent:

        def write_and_stop() -> None:
            try:
                with silent.writing():
                    stopped.set()
                    wake.wait(30)
            except StorageFailed as error:
                told.append(error)

        monkeypatch.setattr(dialect, "SILENT_S", 1.0)
        writer = threading.Thread(target=write_and_stop)
        writer.start()
        stopped.wait(30)
        monkeypatch.undo()
        began = time.monotonic()
        enroll(store, "hall")
        assert time.monotonic() - began < 10
        wake.set()
        writer.join()
    assert ["silent for too long" in str(error) for error in told] == [True]
