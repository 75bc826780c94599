"""Snapshots of a runtime that keeps none."""

import tempfile
from collections.abc import Callable
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from schemas import wire
from schemas.errors import NotFound

AT = datetime(2026, 3, 1, 9, 30, tzinfo=UTC)
JOB: dict[str, Any] = {
    "id": "j3", "kind": "snapshot", "state": "waiting", "map": "belfry", "view": None, "attempts": 0, "progress": None,
    "result": None, "created_at": AT, "finished_at": None, "failure": None, "links": {},
}  # fmt: skip


class FakeSnapshots:
    """One snapshot, of the map ``belfry``."""

    async def make_snapshot(self, name: str) -> wire.Job:
        if name == "nowhere":
            raise NotFound("map", name)
        return wire.Job.model_validate(JOB)

    async def snapshot(self, snapshot_id: str) -> wire.Snapshot:
        return wire.Snapshot(
            id=snapshot_id, map="belfry", created_at=AT, revision=1, recipe="r", views=1, image_bytes=1, bytes=8,
            links={},
        )  # fmt: skip

    async def snapshots(self) -> wire.Snapshots:
        return wire.Snapshots(snapshots=[await self.snapshot("s1")])

    async def open_snapshot(self, snapshot_id: str) -> tuple[wire.Snapshot, BinaryIO]:
        return await self.snapshot(snapshot_id), BytesIO(b"snapshot")

    async def delete_snapshot(self, snapshot_id: str) -> wire.Snapshot:
        return await self.snapshot(snapshot_id)

    async def receiving(self, name: str, size: int) -> Path:
        return Path(tempfile.gettempdir()) / f"revisit-test-{name}"

    async def admit(self, size: int) -> None: ...

    async def restore(self, path: Path, name: str | None, allow: Callable[[str], None]) -> wire.RestoredMap:
        name = name or "belfry"
        allow(name)
        assert path.read_bytes()
        return wire.RestoredMap(map=name, snapshot="s1", views=1, pending=0, revision=1, new_ids=False, links={})
