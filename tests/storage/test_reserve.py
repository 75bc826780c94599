"""On a full disk the reserve is given up for whatever makes room, and for nothing else."""

import errno
import os
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from schemas.errors import DiskFull
from schemas.map_changes import MapChanges
from schemas.records import Filters
from tests.storage.material import NOW, describe_all, enroll, recipe
from worker.storage import space
from worker.storage.store import SqlStore, open_store

RESERVE_BYTES = 100_000

FREES: dict[str, Callable[[SqlStore, str], object]] = {
    "delete views": lambda store, job: store.removals.delete_views("campus", Filters()),
    "delete a map": lambda store, job: store.removals.delete_map("campus"),
    "cancel a job": lambda store, job: store.jobs.cancel(job, NOW),
    "keep no images": lambda store, job: store.maps.change("moon", MapChanges(keep_images=False)),
    "keep no queries": lambda store, job: store.maps.change("campus", MapChanges(keep_queries=0)),
    "discard a shadow": lambda store, job: store.jobs.discard_shadow("campus", NOW),
}
OTHERS: dict[str, Callable[[SqlStore, str], object]] = {
    "enrol": lambda store, job: enroll(store, "pond"),
    "keep queries": lambda store, job: store.maps.change("campus", MapChanges(keep_queries=1)),
    "begin a job": lambda store, job: store.jobs.queue_snapshot("moon", NOW),
}


@pytest.mark.parametrize(
    ("total", "left", "takes", "found"),
    [
        (5000, 99, True, 99),
        (5000, 0, False, 0),
        (0, 0, True, None),  # btrfs has no such limit
        (5000, 0, True, None),  # and some say that nothing is left, whatever they take
    ],
)
def test_only_inodes_that_run_out_stop_enrolments(
    data: Path, monkeypatch: pytest.MonkeyPatch, total: int, left: int, takes: bool, found: int | None
) -> None:
    real = os.statvfs(data)
    told = os.statvfs_result((*real[:5], total, left, left, *real[8:]))
    monkeypatch.setattr(os, "statvfs", lambda _: told)
    monkeypatch.setattr(space, "_refuses", lambda _: not takes)

    assert space.free_inodes(data) == found
    kept, unkept = space.Space([data], 1000), space.Space([data], 0)
    assert kept.inodes() == found
    assert unkept.problem() is None
    unkept.admit(1)
    if found is None:
        assert kept.problem() is None
        kept.admit(1)
    else:
        assert f"{found} inodes are left" in str(kept.problem())
        with pytest.raises(DiskFull, match="inodes"):
            kept.admit(1)


@pytest.mark.parametrize("name", [*FREES, *OTHERS])
def test_the_reserve_is_given_up_for_what_makes_room(database_url: str, data: Path, name: str) -> None:
    with closing(open_store(database_url, data, RESERVE_BYTES)) as store:
        for of in ("campus", "moon"):
            enroll(store, "gate", map=of)
        describe_all(store)
        store.jobs.begin_shadow("campus", recipe("paper"), 5, NOW)
        job = store.jobs.queue_snapshot("campus", NOW).id
        assert store._database.space is not None
        store._database.space.restore()
        reserve = data / space.RESERVE
        without: list[str] = []

        @sa.event.listens_for(store._database.engine, "before_cursor_execute")
        def full(connection: Any, cursor: Any, statement: str, *_: object) -> None:
            if statement.startswith(("INSERT", "UPDATE", "DELETE")):
                if reserve.exists():
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                without.append(statement)

        if name in FREES:
            FREES[name](store, job)
        else:
            with pytest.raises(DiskFull):
                OTHERS[name](store, job)
        assert bool(without) == (name in FREES)
