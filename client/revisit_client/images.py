"""Calls that answer images."""

from revisit_client import wire
from revisit_client.connection import Connection
from revisit_client.parameters import address, texts


class ImageCalls:
    """The part of `Revisit` that fetches images of views, and what is drawn from them."""

    _connection: Connection

    def explanation(self, query_id: str, view: str | None = None) -> bytes:
        """PNG of what decided about a match (default: the best) of a query made with `explain`, beside a rival."""
        return self._connection.send(
            "GET", address("queries", query_id, "explanation.png"), params=texts({"view": view})
        ).content

    def changes(self, view_id: str, since: str) -> wire.Changes:
        """What is gone, new or moved from the view `since` to another one of the same place."""
        return self._connection.receive(
            wire.Changes, "GET", address("views", view_id, "changes"), params={"since": since}
        )

    def draw_changes(self, view_id: str, since: str) -> bytes:
        """PNG of both views, with what changed outlined."""
        return self._connection.send("GET", address("views", view_id, "changes.png"), params={"since": since}).content

    def changes_of_query(self, query_id: str) -> wire.Changes:
        """What is gone, new or moved from the first match of a query made with `explain` to its photo."""
        return self._connection.receive(wire.Changes, "GET", address("queries", query_id, "changes"))

    def draw_changes_of_query(self, query_id: str) -> bytes:
        """PNG of the first match and the photo of an explained query, with what changed outlined."""
        return self._connection.send("GET", address("queries", query_id, "changes.png")).content

    def image(self, view_id: str) -> bytes:
        """The image as it was enrolled, without its metadata (EXIF, position, comments); HEIC comes as JPEG."""
        return self._connection.send("GET", address("views", view_id, "image")).content

    def thumbnail(self, view_id: str) -> bytes:
        """A small JPEG of the image."""
        return self._connection.send("GET", address("views", view_id, "thumbnail")).content

    def segmentation(self, view_id: str, *, overlay: bool = False, legend: bool = False) -> bytes:
        """Indexed PNG of the map's labels; with `overlay` their colours over the image, with `legend` a key below."""
        params = texts({"overlay": overlay or None, "legend": legend or None})
        return self._connection.send("GET", address("views", view_id, "segmentation.png"), params=params).content

    def graph(self, view_id: str, *, legend: bool = False) -> bytes:
        """PNG of the context graph over the image, with `legend` a key below."""
        params = texts({"legend": legend or None})
        return self._connection.send("GET", address("views", view_id, "graph.png"), params=params).content
