"""The address that a process listens on."""

import ipaddress
import socket
from typing import TYPE_CHECKING

from app.cli.console import Failure

if TYPE_CHECKING:
    from schemas.settings import Settings


def is_loopback(host: str) -> bool:
    """Whether an address can be reached from this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def listen(settings: "Settings") -> socket.socket:
    """Bind the port before anything slow, so that a taken port is reported at once."""
    listening: socket.socket | None = None
    try:
        family = socket.getaddrinfo(settings.host, settings.port, type=socket.SOCK_STREAM)[0][0]
        # asyncio sets TCP_NODELAY only where the protocol is named; without it each answer takes some 40 ms longer.
        listening = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((settings.host, settings.port))
    except OSError as error:
        if listening is not None:
            listening.close()
        raise Failure(
            f"cannot listen on {settings.host}:{settings.port} ({error.strerror or error}); "
            "is another service running there? --port chooses another port, 0 a free one"
        ) from None
    return listening


def address(host: str, port: int) -> str:
    """The URL at which this machine reaches what listens there."""
    shown = "127.0.0.1" if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
    return f"http://{shown}:{port}"
