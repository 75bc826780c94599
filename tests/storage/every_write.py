"""Runs in a process with failing_writes.c: each operation of a store with its n-th write failing, for every n.

Prints one line of JSON for each operation: how many writes were let fail, one after another.
"""

import errno
import json
import os
import shutil
import sqlite3
import sys
from collections.abc import Callable
from contextlib import suppress
from datetime import date
from pathlib import Path
from typing import Any

from schemas.ageing import DayScore
from schemas.errors import DiskFull, NotFound, StorageFailed
from schemas.inbox import QueryToKeep
from schemas.map_changes import MapChanges
from schemas.records import Filters, Replay, ViewAttributes
from tests.compiled_once import compile_once
from tests.failing_writes import FailingWrites
from tests.storage.databases import sqlite_url
from tests.storage.material import NOW, RECIPE, describe_all, description, enroll, facts, finish, image, recipe
from worker.storage.owner_file import OWNER
from worker.storage.store import SqlStore, open_store

Operation = Callable[[SqlStore], object]
State = tuple[dict[str, list[Any]], set[str]]


def prepared(folder: Path) -> None:
    """A store with a map of three views, one of them pending, a call that runs, and a map whose deletion was cut."""
    store = open_store(sqlite_url(folder), folder)
    for name in ("gate", "pond"):
        enroll(store, name)
    enroll(store, "elsewhere", map="other")
    describe_all(store)
    enroll(store, "stairs")
    store.calls.begin("runs", "f", NOW)
    store.maps.change("campus", MapChanges(keep_queries=1))
    store.maps.change("campus", MapChanges(keep_matches=1))
    keep_scores(store, 1)
    keep_query(store, "dock")
    for name in ("shadowed", "described"):
        store.maps.put(name, RECIPE, NOW)
        store.jobs.begin_shadow(name, recipe("paper"), 5, NOW)
    claim = store.jobs.claim_map_job("worker", NOW)
    assert claim is not None
    store.jobs.finish_shadow(claim, {"wanted": 5, "queries": []}, NOW)
    store.close()


def keep_query(store: SqlStore, name: str) -> None:
    """Keep a query that matched nothing."""
    store.kept_queries.keep("campus", QueryToKeep(name, RECIPE.description, description(1), image(name), NOW))


def keep_scores(store: SqlStore, *days: int) -> None:
    """Keep scores of the first view on some days of March."""
    scores = [DayScore(date(2026, 3, day), 1, 0.5) for day in days]
    store.day_scores.add("campus", RECIPE, {store.views.get(view_named(store, "gate")).seq: scores})


def state(folder: Path) -> State:
    """All rows and all image files; fails when the database is not sound."""
    with sqlite3.connect(folder / "revisit.db") as database:
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert database.execute("PRAGMA foreign_key_check").fetchall() == []
        names = [name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        rows = {name: sorted(map(repr, database.execute(f"SELECT * FROM {name}"))) for name in names}
        needed = {digest for (digest,) in database.execute("SELECT sha256 FROM views")}
    database.close()
    files = {
        path.name for path in (folder / "pictures").rglob("*") if path.is_file() and path.name not in (".lock", OWNER)
    }
    assert needed <= files, "a view without its image"
    return rows, files


def view_named(store: SqlStore, name: str) -> str:
    """Id of the view of an image."""
    digest = facts(image(name)).sha256
    views, _ = store.views.list(None, Filters())
    return next(view.id for view in views if view.image.sha256 == digest)


def describe(store: SqlStore) -> object:
    """Claim the pending view and store its description."""
    return [finish(store, claim) for claim in store.jobs.claim("worker", 10)]


SETTINGS = MapChanges(
    ranking=lambda recipe: recipe.ranking.model_copy(update={"candidates": 7}),
    keep_queries=0,
    keep_matches=0,
    refuse_poor=True,
)
"""Several of a map's settings, which change together."""

OPERATIONS: dict[str, Operation] = {
    "enrol": lambda store: enroll(store, "new"),
    "enrol into a new map": lambda store: enroll(store, "new", map="fresh"),
    "describe": describe,
    "delete a view": lambda store: store.removals.delete_view(view_named(store, "gate")),
    "delete views": lambda store: store.removals.delete_views("campus", Filters()),
    "delete a map": lambda store: store.removals.delete_map("campus"),
    "patch": lambda store: store.views.change(view_named(store, "gate"), lambda _: ViewAttributes(place="hall")),
    "change a map": lambda store: store.maps.change("campus", SETTINGS),
    "put a map": lambda store: store.maps.put("fresh", RECIPE, NOW),
    "switch the recipe": lambda store: store.jobs.switch_recipe("campus", recipe("paper"), NOW),
    "begin a shadow": lambda store: store.jobs.begin_shadow("other", recipe("paper"), 5, NOW),
    "switch to a shadow": lambda store: store.jobs.switch_to_shadow("shadowed", NOW),
    "discard a shadow": lambda store: store.jobs.discard_shadow("described", NOW),
    "begin a call": lambda store: store.calls.begin("new", "f", NOW),
    "end a call": lambda store: store.calls.end("runs", Replay(201, {}, b"{}"), NOW),
    "keep a query": lambda store: keep_query(store, "tower"),
    "keep no queries": lambda store: store.maps.change("campus", MapChanges(keep_queries=0)),
    "keep scores": lambda store: keep_scores(store, 1, 2),
    "keep no scores": lambda store: store.maps.change("campus", MapChanges(keep_matches=0)),
    "recover": lambda store: store.recover(),
}

IN_STEPS = {"describe", "delete views", "delete a map", "recover"}
"""Several transactions: after a failure some may be done, and the same call, or a start, does the rest."""


def tried(name: str, operation: Operation, template: Path, scratch: Path, faults: FailingWrites, failure: int) -> int:
    """Let every write of an operation fail, one after another and all that follow; returns how many there were."""
    before = state(template)
    number = 0
    while True:
        number += 1
        folder = scratch / f"{number}"
        shutil.copytree(template, folder)
        store = open_store(sqlite_url(folder), folder)
        store.maps.all()
        error = None
        faults.fail(failure, after=number)
        try:
            operation(store)
        except (DiskFull, StorageFailed) as raised:
            error = raised
            assert isinstance(error, DiskFull), f"{name}, write {number}: {error.detail}"
        failed = faults.end()
        rows, files = state(folder)
        if error is not None and name not in IN_STEPS:
            assert (rows, files) == before, f"{name}, write {number}: something half was left"
        if error is not None:  # the cause is gone: the same store does the same call
            with suppress(NotFound):  # a deletion of a map that had begun
                operation(store)
        store.recover()
        store.close()
        _, files = state(folder)
        with sqlite3.connect(folder / "revisit.db") as database:
            needed = {digest for (digest,) in database.execute("SELECT sha256 FROM views")}
            assert database.execute("SELECT count(*) FROM maps WHERE name IS NULL").fetchone() == (0,)
        database.close()
        assert files == needed, f"{name}, write {number}: an image without a view"
        shutil.rmtree(folder)
        if not failed:
            assert error is None
            return number - 1


def main(folder: Path, failure: int) -> None:
    """Try every operation below a folder, with writes that fail with an errno."""
    compile_once()
    faults = FailingWrites({}, Path(os.environ["FAULTS_CONTROL"]))
    template = folder / "template"
    template.mkdir()
    prepared(template)
    for name, operation in OPERATIONS.items():
        scratch = folder / "scratch"
        scratch.mkdir()
        print(
            json.dumps({"operation": name, "writes": tried(name, operation, template, scratch, faults, failure)}),
            flush=True,
        )
        shutil.rmtree(scratch)


if __name__ == "__main__":
    main(Path(sys.argv[1]), getattr(errno, sys.argv[2]))
