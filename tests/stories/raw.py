"""HTTP by hand: bytes to a real service, and what comes back until it closes."""

import json
import socket
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from tests.stories.running import RunningService


@dataclass(frozen=True)
class Answer:
    """One answer as it stood on the wire."""

    status: int
    headers: dict[str, str]
    body: bytes

    def problem(self) -> str:
        """The code of the problem; it must be a whole one, with the request id of the header."""
        assert self.headers["content-type"] == "application/problem+json", self
        told: dict[str, Any] = json.loads(self.body)
        assert told["status"] == self.status
        assert told["request_id"] == self.headers["x-request-id"]
        assert told["title"]
        assert told["detail"]
        return str(told["type"]).removeprefix("urn:revisit:problem:")


def connect(service: RunningService, timeout: float = 20) -> socket.socket:
    """A connection on which nothing was sent."""
    address = urlsplit(service.url)
    assert address.hostname
    assert address.port
    return socket.create_connection((address.hostname, address.port), timeout)


def read_all(connection: socket.socket) -> bytes:
    """What comes until the service ends the connection; a reset raises."""
    return b"".join(iter(lambda: connection.recv(65536), b""))


def answers(raw: bytes) -> list[Answer]:
    """The answers in a stretch of bytes; each needs a Content-Length."""
    found = []
    while raw:
        head, _, rest = raw.partition(b"\r\n\r\n")
        first, *lines = head.decode("latin-1").split("\r\n")
        status = int(first.split()[1])
        headers = {name.lower(): value for name, _, value in (line.partition(": ") for line in lines)}
        size = int(headers.get("content-length", "0"))
        assert len(rest) >= size, f"the answer breaks off: {raw!r}"
        found.append(Answer(status, headers, rest[:size]))
        raw = rest[size:]
    return found


def say(service: RunningService, data: bytes) -> list[Answer]:
    """Send bytes on a connection of their own, and read until the service closes it."""
    with connect(service) as connection:
        connection.sendall(data)
        return answers(read_all(connection))


def read_one(connection: socket.socket) -> Answer:
    """One answer on a connection that stays open."""
    raw = b""
    while not raw.endswith(b"\r\n\r\n"):
        raw += connection.recv(1)
    size = int(raw.lower().partition(b"content-length: ")[2].partition(b"\r\n")[0])
    while size:
        raw += (piece := connection.recv(size))
        size -= len(piece)
    (answer,) = answers(raw)
    return answer
