"""Use-cases for what changed at a place."""

import asyncio
from typing import TYPE_CHECKING

from app.http.changes_report import changes
from app.http.long_work import LongWork
from schemas import wire

if TYPE_CHECKING:
    from worker.runtime.services import Services


class ChangeCuration:
    """The part of `app.http.curate.Curator` that tells what changed between two photos of a place."""

    _services: "Services"
    _drawings: LongWork

    async def changes(self, view_id: str, since: str) -> wire.Changes:
        """What changed from the view `since` to another one."""
        found = await self._drawings.run(self._services.changes.between, view_id, since)
        return changes(found, f"/views/{view_id}/changes.png?since={since}")

    async def draw_changes(self, view_id: str, since: str) -> bytes:
        """Both views with what changed outlined."""
        return await self._drawings.run(self._services.changes.draw_between, view_id, since)

    async def changes_version(self, view_id: str, since: str) -> str:
        """A version of what `draw_changes` draws, as an ETag."""
        return f'"{await asyncio.to_thread(self._services.changes.version, view_id, since)}"'

    async def changes_of_query(self, query_id: str) -> wire.Changes:
        """What changed from the first match of an explained query to its image."""
        found = await self._drawings.run(self._services.changes.of_query, query_id)
        return changes(found, f"/queries/{query_id}/changes.png")

    async def draw_changes_of_query(self, query_id: str) -> bytes:
        """The first match of an explained query and its image, with what changed outlined."""
        return await self._drawings.run(self._services.changes.draw_query, query_id)
