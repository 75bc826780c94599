"""The uvicorn server: bounded connections, and a stop that answers every caller."""

import asyncio
import contextlib
import ctypes
import logging
import os
import signal
import socket
import struct
import sys
from collections.abc import Callable
from dataclasses import replace
from types import FrameType

import uvicorn
from starlette.types import ASGIApp

from app.http.connection import protocol_with
from app.http.limits import IDLE_S, ConnectionLimits
from app.http.open_files import LoopTrouble, connections_allowed
from schemas.settings import Settings
from schemas.threads import Threads

log = logging.getLogger("revisit")

LAST_ANSWERS_S = 2.0
"""Seconds for the answers of requests that were broken off to be sent."""

STAY_S = 0.5
"""Seconds for which open connections may still send a request, once all is answered and the port is closed."""

ACCEPT_S = 0.1
"""Seconds to accept the callers that were connecting when the port is closed."""

LOOK_EVERY_S = 30.0
"""Seconds between looks whether only a restart helps."""

LOOKS = 10
"""Looks in a row that must find so before the process ends: a supervisor that asks ``/livez`` has acted before."""

PARTING_S = 10.0
"""Seconds that an end for that reason takes at most, once callers have their answers: what it waits for may hang."""

_SO_ATTACH_FILTER = 26
"""`asm-generic/socket.h`; Python does not name it."""


def configured(app: ASGIApp, settings: Settings) -> uvicorn.Config:
    """uvicorn's configuration: HTTP/1.1 by h11, without WebSockets, within the limits of the settings."""
    limits = ConnectionLimits.of(settings)
    return uvicorn.Config(
        app,
        http=protocol_with(replace(limits, connections=connections_allowed(limits.connections))),
        ws="none",
        log_config=None,
        access_log=False,  # app.http.middleware writes the access log
        server_header=False,
        timeout_keep_alive=round(IDLE_S),
        timeout_graceful_shutdown=round(IDLE_S),  # for connections only; requests have `Server.grace_s`
        lifespan="on",
    )


class Server(uvicorn.Server):
    """uvicorn's server, which keeps listening while it drains.

    Parameters
    ----------
    config : uvicorn.Config
        From `configured`.
    grace_s : float
        Seconds that requests under way may take once a signal has come.
    drain : callable
        Called when the signal has come, before any request is broken off.
    announce : callable
        Called once the port is open.
    beyond_help : callable
        What only a restart mends, in words, or None. After `LOOKS` looks that found the same, the server stops.
    leave : callable
        Called, in a thread, where such a stop does not end: puts back what others can do.
    """

    def __init__(
        self,
        config: uvicorn.Config,
        grace_s: float,
        drain: Callable[[], None],
        announce: Callable[[], None],
        beyond_help: Callable[[], str | None] = lambda: None,
        leave: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(config)
        self._grace_s, self._drain, self._announce = grace_s, drain, announce
        self._beyond_help, self._leave = beyond_help, leave
        self.gave_up = False
        """Whether it stopped because only a restart helps."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the application, open the port and say so."""
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(LoopTrouble())
        loop.set_default_executor(Threads(None, "revisit-calls"))
        await super().startup(sockets=sockets)
        if self.started:
            self._announce()
            self._watching = asyncio.create_task(self._watch())

    async def _watch(self) -> None:
        """Stop once only a restart helps: not every supervisor asks ``/livez``, but all see a process end."""
        looks, trouble = 0, None
        while looks < LOOKS:
            await asyncio.sleep(LOOK_EVERY_S)
            trouble = self._beyond_help()
            looks = 0 if trouble is None else looks + 1
        log.critical("ends, so that it is started anew: %s", trouble, extra={"event": "gave_up"})
        self.gave_up = self.should_exit = True

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """On the first signal stop in order, on the second at once."""
        self.force_exit = bool(self._captured_signals)  # it may have begun to stop by itself
        self._captured_signals.append(sig)
        self.should_exit = True

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Refuse what is new, finish what is under way, then close."""
        self._watching.cancel()
        loop = asyncio.get_running_loop()
        until = loop.time() + self._grace_s
        under_way = set(self.server_state.tasks)
        self._drain()
        log.info("stopping: %d requests are under way", len(under_way), extra={"event": "draining"})
        while under_way and not self.force_exit and loop.time() < until:
            _, under_way = await asyncio.wait(under_way, timeout=0.1)
        if not self.force_exit:
            await self._close_port(sockets or [])
        if self.server_state.tasks:
            # `app.http.middleware.RequestContext` answers 503 for them; uvicorn would send a text without a type.
            late = set(self.server_state.tasks)
            for task in late:
                task.cancel()
            await asyncio.wait(late, timeout=LAST_ANSWERS_S)
        ending = asyncio.ensure_future(super().shutdown(sockets))
        last = loop.time() + PARTING_S if self.gave_up else float("inf")
        while not ending.done() and not self.force_exit and loop.time() < last:
            await asyncio.wait({ending}, timeout=0.1)
        if ending.done() and not self.force_exit:
            return await ending
        if self.force_exit:
            await asyncio.wait({ending}, timeout=STAY_S)  # it waits for nobody now, or for work that may hang
            log.warning("stopped at once by a second %s", signal.Signals(self._captured_signals[-1]).name)
        else:
            await asyncio.wait({asyncio.ensure_future(asyncio.to_thread(self._leave))}, timeout=PARTING_S)
        # Threads at work would delay a regular end; what was acknowledged is on disk.
        logging.shutdown()
        os._exit(1)

    async def _close_port(self, sockets: list[socket.socket]) -> None:
        """Close the port so that nobody who has connected is reset: closing resets what waits to be accepted."""
        for listening in sockets:
            _let_nobody_knock(listening)
        await asyncio.sleep(ACCEPT_S)
        for server in self.servers:
            server.close()
        until = asyncio.get_running_loop().time() + STAY_S
        while self.server_state.connections and asyncio.get_running_loop().time() < until and not self.force_exit:
            await asyncio.sleep(0.02)


def _let_nobody_knock(listening: socket.socket) -> None:
    """Keep a listening socket from beginning handshakes; those that are done can still be accepted.

    On Linux by a filter (classic BPF, `socket(7)`) that drops segments with SYN: whoever connects now tries again after
    a second, and is then refused, for the port is closed. Elsewhere the queue is made as short as it can be: one may
    still wait in it when the port closes, and is reset.
    """
    listening.listen(0)
    if sys.platform != "linux":
        return
    # Load the byte of TCP's flags; with SYN (2) keep 0 bytes of the segment, else all.
    program = struct.pack("HBBI" * 4, 0x30, 0, 0, 13, 0x45, 1, 0, 2, 0x06, 0, 0, 0xFFFFFFFF, 0x06, 0, 0, 0)
    held = ctypes.create_string_buffer(program)
    with contextlib.suppress(OSError):  # a sandbox may allow no filters
        listening.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("HP", 4, ctypes.addressof(held)))
