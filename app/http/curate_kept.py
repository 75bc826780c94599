"""Use-cases for what maps keep: blurred images, and queries that are unknown places or proposed views."""

import asyncio
from typing import TYPE_CHECKING

from app.http import enrolment_presenters
from app.http.health_report import proposals, unknown_places
from app.http.long_work import LongWork
from schemas import wire
from schemas.records import ViewAttributes

if TYPE_CHECKING:
    from worker.runtime.services import Services


class KeptQueryCuration:
    """The part of `app.http.curate.Curator` that is about queries which are kept."""

    _services: "Services"
    _long: LongWork

    async def unknown(self, name: str, limit: int) -> wire.UnknownPlaces:
        """Queries that matched nothing, by spot: at most `limit` spots."""
        return unknown_places(name, await self._long.run(self._services.inbox.of, name), limit)

    async def kept_image(self, name: str, query_id: str) -> bytes:
        """A small JPEG of a kept query."""
        return await asyncio.to_thread(self._services.inbox.image, name, query_id)

    async def name_unknown(self, name: str, place_id: str, attributes: ViewAttributes) -> wire.NamedPlace:
        """Enrol images of an unknown place as views with these attributes."""
        enrolled, removed = await self._long.run(self._services.inbox.name, name, place_id, attributes)
        return wire.NamedPlace(views=[enrolment_presenters.enrolled(one).view for one in enrolled], queries=removed)

    async def dismiss_unknown(self, name: str, place_id: str) -> wire.DismissedPlace:
        """Delete the queries of an unknown place."""
        return wire.DismissedPlace(queries=await asyncio.to_thread(self._services.inbox.dismiss, name, place_id))

    async def proposals(self, name: str, limit: int) -> wire.Proposals:
        """Queries that matched places although they look unlike their views: at most `limit` places."""
        return proposals(name, await self._long.run(self._services.proposals.of, name), limit)

    async def accept_proposal(self, name: str, proposal_id: str, most: int, unconfirmed: bool) -> wire.NamedPlace:
        """Enrol at most `most` images of a proposal as views of its place."""
        enrolled, removed = await self._long.run(
            self._services.proposals.accept, name, proposal_id, most, unconfirmed=unconfirmed
        )
        return wire.NamedPlace(views=[enrolment_presenters.enrolled(one).view for one in enrolled], queries=removed)

    async def dismiss_proposal(self, name: str, proposal_id: str) -> wire.DismissedPlace:
        """Delete the queries of a proposal."""
        return wire.DismissedPlace(queries=await asyncio.to_thread(self._services.proposals.dismiss, name, proposal_id))
