"""The client's calls about settings and health of maps, their unknown places, and proposed views."""

from collections.abc import Mapping, Sequence
from typing import Any

from revisit_client import wire
from revisit_client.connection import Connection
from revisit_client.parameters import address, texts


class HealthCalls:
    """Calls of `Revisit` about settings and health of maps, their unknown places, and proposed views."""

    _connection: Connection

    def health(self, name: str, *, code: str | None = None, limit: int | None = None) -> wire.MapHealth:
        """What makes a map's answers wrong or missing: `limit` findings of each kind, or of the kind `code` alone."""
        params = texts({"code": code, "limit": limit})
        return self._connection.receive(wire.MapHealth, "GET", address("maps", name, "health"), params=params)

    def change_map(
        self,
        name: str,
        *,
        ranking: Mapping[str, Any] | None = None,
        blur: Sequence[str] | None = None,
        keep_images: bool | None = None,
        keep_queries: int | None = None,
        keep_matches: int | None = None,
        refuse_poor: bool | None = None,
    ) -> wire.MapFacts:
        """Change settings of a map together: all that are given, or, when one of them is refused, none.

        Parameters
        ----------
        name : str
        ranking : mapping or None
            Fields of the ranking config to change, from the next query on; the others stay.
        blur : sequence of str or None
            What is covered in each image before it is stored: `people`, `vehicles`, labels; empty: nothing.
        keep_images : bool or None
            False removes all images, for good, and each later one once its view is described.
        keep_queries, keep_matches : int or None
            How many queries are kept at most that matched nothing, or a view that they look unlike; 0: none.
        refuse_poor : bool or None
            Refuse to enrol images that are dark, overexposed, covered or blurred.
        """
        given = {
            "ranking": None if ranking is None else dict(ranking),
            "blur": None if blur is None else list(blur),
            "keep_images": keep_images,
            "keep_queries": keep_queries,
            "keep_matches": keep_matches,
            "refuse_poor": refuse_poor,
        }
        changes = {field: value for field, value in given.items() if value is not None}
        return self._connection.receive(wire.MapFacts, "PATCH", address("maps", name), json=changes)

    def keep_images(self, name: str, wanted: bool) -> wire.MapFacts:
        """Keep a map's images, or remove them for good: all now, and each later one once its view is described."""
        return self.change_map(name, keep_images=wanted)

    def blur(self, name: str, *words: str) -> wire.MapFacts:
        """Cover `people`, `vehicles` or labels in each image of a map before it is stored; no words: nothing."""
        return self.change_map(name, blur=words)

    def refuse_poor(self, name: str, wanted: bool = True) -> wire.MapFacts:
        """Refuse to enrol images that are dark, overexposed, covered or blurred, or no longer."""
        return self.change_map(name, refuse_poor=wanted)

    def keep_queries(self, name: str, count: int) -> wire.MapFacts:
        """Keep at most `count` queries of a map that matched nothing; 0 deletes those that are kept."""
        return self.change_map(name, keep_queries=count)

    def keep_matches(self, name: str, count: int) -> wire.MapFacts:
        """Keep at most `count` queries of a map that matched a view although they look unlike it; 0 deletes them."""
        return self.change_map(name, keep_matches=count)

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
