"""Unknown places of a runtime that keeps no queries."""

from collections.abc import Sequence

from schemas import wire
from schemas.errors import NotFound
from schemas.records import ViewAttributes
from schemas.requests import PatchMap


class FakeInbox:
    """No unknown place, and nothing to be left out, of any map but ``nowhere``, which does not exist."""

    async def map(self, name: str) -> wire.MapFacts:
        raise NotImplementedError

    async def change_map(self, name: str, changes: PatchMap) -> wire.MapFacts:
        given = changes.model_dump(exclude_none=True)
        ranking = {"id": "changed", **(changes.ranking or {})}
        return (await self.map(name)).model_copy(update={**given, "ranking": ranking})

    async def dynamic_preview(self, name: str, labels: Sequence[str], limit: int) -> wire.DynamicPreview:
        return wire.DynamicPreview(map=name, views=0, before=0, after=0, nothing_left=0, labels=[], most=[])

    async def unknown(self, name: str, limit: int) -> wire.UnknownPlaces:
        if name == "nowhere":
            raise NotFound("map", name)
        return wire.UnknownPlaces(map=name, keep_queries=0, kept=0, examined=0, count=0, places=[])

    async def kept_image(self, name: str, query_id: str) -> bytes:
        raise NotFound("kept query", query_id)

    async def name_unknown(self, name: str, place_id: str, attributes: ViewAttributes) -> wire.NamedPlace:
        raise NotFound("unknown place", place_id)

    async def dismiss_unknown(self, name: str, place_id: str) -> wire.DismissedPlace:
        return wire.DismissedPlace(queries=3)

    async def proposals(self, name: str, limit: int) -> wire.Proposals:
        if name == "nowhere":
            raise NotFound("map", name)
        return wire.Proposals(map=name, keep_matches=0, kept=0, examined=0, count=0, proposals=[])

    async def accept_proposal(self, name: str, proposal_id: str, most: int, unconfirmed: bool) -> wire.NamedPlace:
        raise NotFound("proposal", proposal_id)

    async def dismiss_proposal(self, name: str, proposal_id: str) -> wire.DismissedPlace:
        return wire.DismissedPlace(queries=3)
