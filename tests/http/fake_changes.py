"""What changed at a place, for tests of the routes: no two photos of the fake can be aligned."""

from typing import Any

from schemas import wire
from schemas.errors import Busy, NotFound


class FakeChanges:
    """The part of the fake service that compares photos; `away` is raised instead."""

    away: Busy | None = None

    def _view(self, view_id: str) -> Any:
        raise NotImplementedError

    async def changes(self, view_id: str, since: str) -> wire.Changes:
        self._view(view_id)
        self._view(since)
        return self._unaligned(since)

    async def draw_changes(self, view_id: str, since: str) -> bytes:
        self._view(view_id)
        self._view(since)
        return b"changes"

    async def changes_version(self, view_id: str, since: str) -> str:
        return f'"{self._view(view_id).facts.sha256[:12]}-{self._view(since).facts.sha256[:12]}"'

    async def changes_of_query(self, query_id: str) -> wire.Changes:
        if self.away is not None:
            raise self.away
        return self._unaligned(None)

    async def draw_changes_of_query(self, query_id: str) -> bytes:
        raise NotFound("explained query", query_id)

    def _unaligned(self, since: str | None) -> wire.Changes:
        return wire.Changes(
            status="not-aligned", detail="few", since=since, compared=0, similarity=None, changes=[], links={}
        )
