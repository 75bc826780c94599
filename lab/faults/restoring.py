"""Snapshots of maps and what is made of them, each operation done to the model as well."""

from dataclasses import replace
from typing import Any

from lab.faults.comparing import compare_views, views_of
from lab.faults.enrolling import MAPS
from lab.faults.ledger import Known, KnownMap, require
from lab.faults.map_changes import MapChanges

TAR = {"content-type": "application/x-tar"}


class Restoring(MapChanges):
    """Operations that make snapshots, and maps of them."""

    def restore(self) -> None:
        """A snapshot of a map, then some changes, then a map of the snapshot: as it was, in its place or beside it."""
        of = self.some_map()
        self._await_switch(of)
        self.note(f"POST /maps/{of.name}/snapshots")
        job = self.served.call("POST", f"/maps/{of.name}/snapshots", 202).json()["id"]
        state = self.served.await_job(job)
        require(state == "done", f"the snapshot of {of.name} is {state}")
        kept = [replace(view) for view in of.views.values()]  # as they were; some are changed or deleted now
        self._change_something()
        free = [name for name in MAPS if name not in self.maps]
        name = str(self.chance.choice(free)) if free else of.name
        if name in self.maps:
            self._delete_map(self.maps[name])
        self.note(f"POST /restore {len(kept)} views of {of.name} as {name}")
        file = self.served.call("GET", f"/snapshots/{job}").content
        made = self.served.call("POST", "/restore", 201, params={"as": name}, content=file, headers=TAR).json()
        self._learn_map(name, of, kept, made)
        self.served.call("POST", "/restore", 409, params={"as": name}, content=file, headers=TAR)
        self.served.call("DELETE", f"/snapshots/{job}")
        self.served.call("GET", f"/snapshots/{job}", 404)

    def _change_something(self) -> None:
        for _ in range(int(self.chance.integers(4))):
            change = [self.patch, self.delete, self.enroll_unawaited, self.delete_map][int(self.chance.integers(4))]
            change()

    def _learn_map(self, name: str, of: KnownMap, kept: list[Known], made: dict[str, Any]) -> None:
        """Take a restored map into the model; its views have the ids that they had unless one of them is in use."""
        require(made["views"] == len(kept), f"{made['views']} views were restored of {len(kept)}")
        in_use = {view.id for other in self.maps.values() for view in other.views.values()}
        wanted = not in_use.isdisjoint(view.id for view in kept)
        require(made["new_ids"] == wanted, f"new ids: {made['new_ids']}, and {wanted} was expected")
        ids = [view["id"] for view in views_of(self.served, name)] if wanted else [view.id for view in kept]
        require(len(ids) == len(kept), f"{len(ids)} views are listed, {len(kept)} were restored")
        views = {id_: replace(view, id=id_, map=name) for id_, view in zip(ids, kept, strict=True)}
        self.maps[name] = KnownMap(name, of.recipe, of.ranking, made["revision"], views, untimely=True)
        self.deleted = [gone for gone in self.deleted if gone not in views]
        compare_views(self.served, self.maps[name])
