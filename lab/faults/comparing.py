"""What the service holds, compared with what it acknowledged: over HTTP, in its tables and in its folder."""

import hashlib
import sqlite3
from collections.abc import Iterable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from lab.faults.ledger import Known, KnownMap, require
from lab.faults.live_service import LiveService
from worker.storage.owner_file import OWNER

PAGE = 500

ORPHANS = {
    "descriptions without a view": "SELECT count(*) FROM descriptions WHERE seq NOT IN (SELECT seq FROM views)",
    "jobs without a map": "SELECT count(*) FROM jobs WHERE map_id NOT IN (SELECT id FROM maps)",
    "describe jobs without a view": "SELECT count(*) FROM jobs WHERE seq IS NOT NULL"
    " AND seq NOT IN (SELECT seq FROM views)",
    "metadata without a view": "SELECT count(*) FROM metadata_pairs WHERE seq NOT IN (SELECT seq FROM views)",
    "views without a map": "SELECT count(*) FROM views WHERE map_id NOT IN (SELECT id FROM maps)",
    "maps without a name": "SELECT count(*) FROM maps WHERE name IS NULL",
    "ready views without a description": "SELECT count(*) FROM views JOIN maps ON maps.id = views.map_id"
    " WHERE state = 'ready' AND NOT EXISTS (SELECT 1 FROM descriptions"
    " WHERE descriptions.seq = views.seq AND descriptions.recipe = maps.recipe)",
}
"""Rows that nothing should own; no answer over HTTP would show them."""


def views_of(served: LiveService, name: str | None = None, page: int = PAGE, **filters: str) -> list[Any]:
    """All views of a map or of all, read page by page."""
    found: list[Any] = []
    parameters = {"limit": str(page), **filters} | ({} if name is None else {"map": name})
    while True:
        answer = served.json("/views", **parameters)
        found += answer["views"]
        if answer["next"] is None:
            return found
        require(len(answer["views"]) == page, f"a page of {len(answer['views'])} of {page} views has a next one")
        parameters["cursor"] = answer["next"]


def compare_views(served: LiveService, of: KnownMap, page: int = PAGE) -> None:
    """The views of a map: exactly the acknowledged ones, in the order of enrolment, as they were acknowledged."""
    shown = views_of(served, of.name, page)
    compare_lists(of.name, of.views.values(), shown)
    for view in shown:
        of.views[view["id"]].compare(view)
        require(view["state"] != "failed", f"view {view['id']} failed: {view.get('failure')}")


def compare_lists(name: str, known: Iterable[Known], shown: Iterable[Mapping[str, Any]]) -> None:
    """The same views in the same order; raises Violation naming those that are missing or should not be there."""
    kept, seen = [view.id for view in known], [view["id"] for view in shown]
    missing, strange = sorted(set(kept) - set(seen)), sorted(set(seen) - set(kept))
    require(not missing, f"map {name}: {len(missing)} acknowledged views are gone: {missing[:5]}")
    require(not strange, f"map {name}: {len(strange)} views that were deleted or never sent: {strange[:5]}")
    require(kept == seen, f"map {name}: the views are not in the order of their enrolment")


def compare_maps(served: LiveService, maps: Mapping[str, KnownMap]) -> None:
    """The maps by name, their counts and recipes, and the places."""
    shown = {facts["name"]: facts for facts in served.json("/maps")["maps"]}
    require(shown.keys() == maps.keys(), f"maps are {sorted(shown)}, not {sorted(maps)}")
    for name, of in maps.items():
        compare_map(of, shown[name])
    places: dict[tuple[str, str], int] = {}
    for of in maps.values():
        for view in of.views.values():
            if view.attributes.place is not None:
                places[of.name, view.attributes.place] = places.get((of.name, view.attributes.place), 0) + 1
    seen = {(row["map"], row["place"]): row["views"] for row in served.json("/places", limit="500")["places"]}
    require(seen == places, f"places are {seen}, not {places}")


def compare_map(of: KnownMap, facts: Mapping[str, Any]) -> None:
    """Counts, recipe, ranking and revision of a map; remembers the revision."""
    counts = facts["views"]
    require(counts["failed"] == 0, f"map {of.name}: {counts['failed']} views failed")
    total = counts["ready"] + counts["pending"]
    require(total == len(of.views), f"map {of.name} counts {total} views, not {len(of.views)}")
    require(facts["revision"] >= of.revision, f"map {of.name}: revision {facts['revision']} after {of.revision}")
    if of.switch is None:
        require(facts["recipe"]["id"] == of.recipe, f"map {of.name}: recipe {facts['recipe']['id']}, not {of.recipe}")
        require(facts["ranking"]["id"] == of.ranking, f"map {of.name}: ranking {facts['ranking']['id']}")
    of.revision = facts["revision"]


def compare_images(served: LiveService, views: Iterable[Known]) -> None:
    """The bytes of views' images are those that were sent."""
    for view in views:
        sent = served.call("GET", f"/views/{view.id}/image").content
        require(hashlib.sha256(sent).hexdigest() == view.digest, f"the image of view {view.id} is not what was sent")


def compare_folder(data: Path, views: Iterable[Known]) -> None:
    """Every image file is of a view and sound, every view has its file, and no row is left over.

    Only while nothing is being written.
    """
    wanted = {view.digest for view in views}
    files = {
        path.name: path
        for path in (data / "pictures").rglob("*")
        if path.is_file() and path.name not in (".lock", OWNER)
    }
    stems = {path.stem for path in files.values()}
    require(stems == wanted, f"{len(stems - wanted)} image files without a view, {len(wanted - stems)} without a file")
    for path in files.values():
        require(hashlib.sha256(path.read_bytes()).hexdigest() == path.stem, f"{path.name} is damaged")
    compare_tables(data / "revisit.db")


def compare_tables(database: Path) -> None:
    """No row is left over in the tables, and SQLite finds them sound."""
    with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True, timeout=30)) as connection:
        for what, query in ORPHANS.items():
            (count,) = connection.execute(query).fetchone()
            require(count == 0, f"{count} {what}")
        broken = connection.execute("PRAGMA foreign_key_check").fetchall()
        require(not broken, f"rows refer to rows that are not there: {broken[:5]}")


def compare_all(served: LiveService, maps: Mapping[str, KnownMap], page: int = PAGE) -> None:
    """Everything, while nothing is being written."""
    served.settle()
    compare_maps(served, maps)
    views = [view for of in maps.values() for view in of.views.values()]
    for of in maps.values():
        compare_views(served, of, page)
    require(len(views_of(served)) == len(views), "all views together are not the views of the maps")
    compare_folder(served.data, views)
