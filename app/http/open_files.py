"""Open files: the process may have as many as its connections and all else need, as far as the system allows."""

import asyncio
import errno
import logging
import resource
import time
from typing import Any

from app.http.limits import RESERVE
from schemas.errors import SetupError

log = logging.getLogger("revisit")

BESIDES = 300
"""Open files besides connections: three for each thread that has the database open, decoders, images that are written.
With a hundred callers there were 45; a machine of many cores has up to a hundred threads."""

LEAST_CONNECTIONS = 16
"""Fewer are no service."""

SAY_EVERY_S = 60.0
"""Seconds between two lines of the log about connections that cannot be accepted."""


def allow_open_files(connections: int) -> None:
    """Raise the process's own limit of open files (RLIMIT_NOFILE) to what so many connections need, where it is lower.

    Many systems begin with 1024 or 256, and let a process have more when it asks.

    Raises
    ------
    SetupError
        It may not have as many as a service needs.
    """
    wanted = connections + RESERVE + BESIDES
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
    least = LEAST_CONNECTIONS + RESERVE + BESIDES
    if most < min(least, wanted):
        raise SetupError(
            f"a process may have {most} open files here (ulimit -Hn), and serving takes {least}: one for each "
            "connection, and those of the database, of images and of decoders; raise the limit"
        )
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def connections_allowed(connections: int) -> int:
    """As many of so many connections as there may be open files for; fewer are logged as a warning."""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    room = connections if limit == resource.RLIM_INFINITY else limit - RESERVE - BESIDES
    if room < connections:
        log.warning(
            "%d connections are served at once, not %d: this process may have %d open files (ulimit -Hn); raise that, "
            "or lower REVISIT_CONNECTIONS",
            room,
            connections,
            limit,
        )
    return min(connections, room)


class LoopTrouble:
    """The event loop's handler of errors, which says once a minute that connections cannot be accepted.

    asyncio of Python 3.11 reports it 2,048 times for each try, each time with a stack: a gigabyte in minutes.
    """

    def __init__(self) -> None:
        self._said_at = float("-inf")

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """As `asyncio.loop.set_exception_handler` calls it."""
        error, message = context.get("exception"), str(context.get("message"))
        if isinstance(error, OSError) and error.errno in (errno.EMFILE, errno.ENFILE) and "accept" in message:
            self._say(error)
        elif not (isinstance(error, ValueError) and "_start_serving" in message):  # tried again on a port now closed
            loop.default_exception_handler(context)

    def _say(self, error: OSError) -> None:
        now = time.monotonic()
        if now - self._said_at >= SAY_EVERY_S:
            self._said_at = now
            log.error(
                "no connection can be accepted (%s): callers wait, and it is tried again every second; raise the limit "
                "of open files (ulimit -n), or lower REVISIT_CONNECTIONS",
                error.strerror,
                extra={"event": "open_files"},
            )
