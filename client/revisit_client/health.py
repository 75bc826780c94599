"""The client's calls about the health of maps."""

from revisit_client import wire
from revisit_client.connection import Connection
from revisit_client.parameters import texts


class HealthCalls:
    """Calls of `Revisit` about the health of maps."""

    _connection: Connection

    def health(self, name: str, *, code: str | None = None, limit: int | None = None) -> wire.MapHealth:
        """What makes a map's answers wrong or missing: `limit` findings of each kind, or of the kind `code` alone."""
        params = texts({"code": code, "limit": limit})
        return self._connection.receive(wire.MapHealth, "GET", f"/maps/{name}/health", params=params)
