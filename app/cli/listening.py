"""The address that a process listens on, and serving there until it is told to stop."""

import ipaddress
import logging
import os
import signal
import socket
from collections.abc import Callable
from typing import TYPE_CHECKING

from app.cli.output import DONE, FAILED, Failure, say
from app.cli.starting import collecting_new

if TYPE_CHECKING:
    from starlette.types import ASGIApp

    from schemas.settings import Settings

log = logging.getLogger("revisit")


def is_loopback(host: str) -> bool:
    """Whether an address can be reached from this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def listen(settings: "Settings") -> socket.socket:
    """Bind the port before anything slow, so that a taken port, or too few open files, are reported at once."""
    from app.http.open_files import allow_open_files

    allow_open_files(settings.connections)
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


def address(host: str, port: int | str) -> str:
    """The URL at which this machine reaches what listens there."""
    shown = "127.0.0.1" if host in ("0.0.0.0", "::") else f"[{host}]" if ":" in host else host
    return f"http://{shown}:{port}"


def url_of_environment() -> str:
    """The URL of the service that runs by the same variables: REVISIT_URL, or REVISIT_HOST and REVISIT_PORT."""
    here = address(os.environ.get("REVISIT_HOST") or "127.0.0.1", os.environ.get("REVISIT_PORT") or "8000")
    return os.environ.get("REVISIT_URL") or here


def serve_until_stopped(
    app: "ASGIApp",
    settings: "Settings",
    listening: socket.socket,
    what: str,
    *,
    drain: Callable[[], None],
    announce: Callable[[], None],
    beyond_help: Callable[[], str | None],
    leave: Callable[[], None] = lambda: None,
) -> int:
    """Serve on a port that is bound until SIGINT or SIGTERM, or only a restart helps; returns the exit code.

    `what` it is, for the message that it could not start; the others as `app.http.server.Server` has them.
    """
    from app.http.server import Server, configured

    # When it has finished, uvicorn raises the signal that stopped it again; that must not count as a failure.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: None)

    def ready() -> None:
        collecting_new()
        announce()

    server = Server(configured(app, settings), settings.grace_s, drain, ready, beyond_help, leave)
    server.run(sockets=[listening])
    if not server.started:
        say(f"revisit: the {what} could not start; the reason is above")
        return FAILED
    log.info("stopped")
    return FAILED if server.gave_up else DONE
