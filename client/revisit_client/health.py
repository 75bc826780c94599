"""Calls about the health of maps, their unknown places, and proposed views."""

from collections.abc import Mapping

from revisit_client import wire
from revisit_client.connection import Connection
from revisit_client.parameters import address, texts


class HealthCalls:
    """The calls of a client about the health of maps, their unknown places, and proposed views."""

    _connection: Connection

    def health(self, name: str, *, code: str | None = None, limit: int | None = None) -> wire.MapHealth:
        """What makes a map's answers wrong or missing: `limit` findings of each kind, or of the kind `code` alone."""
        params = texts({"code": code, "limit": limit})
        return self._connection.receive(wire.MapHealth, "GET", address("maps", name, "health"), params=params)

    def proposals(self, name: str, *, limit: int | None = None) -> wire.Proposals:
        """Queries that would refresh places: they matched one although they look unlike its views."""
        return self._connection.receive(
            wire.Proposals, "GET", address("maps", name, "proposals"), params=texts({"limit": limit})
        )

    def proposal_image(self, name: str, query_id: str) -> bytes:
        """A small JPEG of a query of a proposal."""
        return self._connection.send("GET", address("maps", name, "proposals", query_id, "image")).content

    def accept_proposal(
        self, name: str, proposal_id: str, *, views: int = 3, unconfirmed: bool = False
    ) -> wire.NamedPlace:
        """Take at most `views` images of a proposal as views of its place, which are described in the background."""
        body, path = {"views": views, "unconfirmed": unconfirmed}, address("maps", name, "proposals", proposal_id)
        return self._connection.receive(wire.NamedPlace, "POST", path, json=body, repeat=False)

    def dismiss_proposal(self, name: str, proposal_id: str) -> wire.DismissedPlace:
        """Delete the queries of a proposal, and their images."""
        return self._connection.receive(wire.DismissedPlace, "DELETE", address("maps", name, "proposals", proposal_id))

    def unknown(self, name: str, *, limit: int | None = None) -> wire.UnknownPlaces:
        """Queries that matched nothing, by spot."""
        return self._connection.receive(
            wire.UnknownPlaces, "GET", address("maps", name, "unknown"), params=texts({"limit": limit})
        )

    def unknown_image(self, name: str, query_id: str) -> bytes:
        """A small JPEG of a query that matched nothing."""
        return self._connection.send("GET", address("maps", name, "unknown", query_id, "image")).content

    def name_unknown(
        self, name: str, place_id: str, place: str, *, position: Mapping[str, float] | None = None
    ) -> wire.NamedPlace:
        """Name an unknown place: its images become views, which are described in the background."""
        body = {"place": place, "position": None if position is None else dict(position)}
        path = address("maps", name, "unknown", place_id)
        return self._connection.receive(wire.NamedPlace, "POST", path, json=body, repeat=False)

    def dismiss_unknown(self, name: str, place_id: str) -> wire.DismissedPlace:
        """Delete the queries of an unknown place, and their images."""
        return self._connection.receive(wire.DismissedPlace, "DELETE", address("maps", name, "unknown", place_id))
