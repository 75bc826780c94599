"""Calls about shadows: a recipe that is tried beside that of a map."""

from revisit_client import wire
from revisit_client.connection import Connection
from revisit_client.parameters import address


class ShadowCalls:
    """The calls of a client about shadows, which `switch_recipe` begins."""

    _connection: Connection

    def shadow(self, name: str) -> wire.Shadow:
        """The shadow of a map, with its table when it is ready; a problem `not-found` when there is none."""
        return self._connection.receive(wire.Shadow, "GET", address("maps", name, "shadow"))

    def switch_to_shadow(self, name: str) -> wire.Job:
        """Change a map over to its shadow, which is ready; the job is done at once, or when the last view is described.

        `switch_recipe` with the fields of the old recipe changes it back.
        """
        return self._connection.receive(wire.Job, "POST", address("maps", name, "shadow", "switch"), repeat=False)

    def discard_shadow(self, name: str) -> wire.Job:
        """Discard the shadow of a map, ready or not: the map keeps its recipe."""
        return self._connection.receive(wire.Job, "DELETE", address("maps", name, "shadow"), repeat=False)
