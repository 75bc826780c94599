"""Shadows of a runtime that describes nothing."""

from typing import Any

from schemas import wire
from schemas.errors import Conflict, NotFound
from tests.http.fake_snapshots import JOB

SHADOW: dict[str, Any] = {
    "map": "belfry", "state": "comparing", "job": "j3", "progress": None, "wanted": 5, "recipe": {}, "ranking": {},
    "table": None, "links": {},
}  # fmt: skip


class FakeShadows:
    """A shadow of every map but ``nowhere``, which does not exist; it is never ready."""

    async def shadow(self, name: str) -> wire.Shadow:
        if name == "nowhere":
            raise NotFound("map", name)
        return wire.Shadow.model_validate({**SHADOW, "map": name})

    async def switch_to_shadow(self, name: str) -> wire.Job:
        raise Conflict(f"the shadow of the map {name!r} is {(await self.shadow(name)).state}")

    async def discard_shadow(self, name: str) -> wire.Job:
        await self.shadow(name)
        return wire.Job.model_validate({**JOB, "kind": "shadow", "state": "cancelled", "map": name})
