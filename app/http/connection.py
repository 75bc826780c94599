"""One HTTP/1.1 connection: bounds on time and size, and refusals that reach clients which are still sending.

uvicorn's protocol on h11, with what it lacks: a deadline for headers, problem details for what cannot be parsed, and a
close that first throws away what the client still sends (RFC 9112, section 9.6). Closing a socket with unread data
resets the connection, and a reset destroys the answer before the client has read it.
"""

import asyncio
import contextlib
import fcntl
import logging
import re
import secrets
import sys
import termios
from functools import partial
from http import HTTPStatus
from typing import Any, ClassVar
from urllib.parse import unquote_to_bytes

import h11
from uvicorn.config import Config
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

from app.http.limits import (
    CROWDED,
    IDLE_S,
    LITTLE_BYTES,
    MOST_HEAD_BYTES,
    PAUSED_S,
    RESERVE,
    STALLED_S,
    ConnectionLimits,
)
from app.http.notes import noting
from app.http.problems import problem

logger = logging.getLogger("revisit.http")

_ABSOLUTE = re.compile(rb"https?://[^/?#]*", re.IGNORECASE)
_VERSIONS = (b"1.0", b"1.1")
_TOO_LARGE = 431


class _Connection(h11.Connection):
    """h11's parser, stricter: what two servers could read in two ways is refused (RFC 9112, section 11.2)."""

    @property
    def has_begun(self) -> bool:
        """Whether there are bytes of a request that is not complete yet, or of the next one."""
        return bool(self._receive_buffer)

    def next_event(self) -> Any:
        """The next event; raises h11.RemoteProtocolError for what is refused."""
        if self.their_state is h11.IDLE:
            self._pass_over_empty_lines()
        event = super().next_event()
        if not isinstance(event, h11.Request):
            return event
        size = len(event.target) + sum(len(name) + len(value) + 4 for name, value in event.headers)
        if size > MOST_HEAD_BYTES:
            raise h11.RemoteProtocolError(f"the headers have {size:,} bytes", error_status_hint=_TOO_LARGE)
        if event.http_version not in _VERSIONS:
            raise h11.RemoteProtocolError(f"HTTP/{event.http_version.decode()} is not spoken here")
        names = [name for name, _ in event.headers]
        if b"transfer-encoding" in names and (b"content-length" in names or event.http_version == b"1.0"):
            raise h11.RemoteProtocolError("Transfer-Encoding cannot stand beside Content-Length, nor in HTTP/1.0")
        return _in_origin_form(event)

    def _pass_over_empty_lines(self) -> None:
        """Before a request line (RFC 9112, section 2.2): small clients end a body with one that they do not count."""
        received = self._receive_buffer._data
        if received.startswith((b"\r", b"\n")):
            self._receive_buffer.maybe_extract_at_most(len(received) - len(received.lstrip(b"\r\n")))


class _RefusedPath(h11.RemoteProtocolError):
    """A path that is refused; where it leads decides in which words."""

    def __init__(self, why: str, path: bytes) -> None:
        super().__init__(why)
        self.path = path.decode("latin-1")


def _in_origin_form(request: h11.Request) -> h11.Request:
    """The request with a path as its target; raises h11.RemoteProtocolError when it cannot be had."""
    target = request.target
    if absolute := _ABSOLUTE.match(target):  # RFC 9112, section 3.2.2: servers must accept it
        rest = target[absolute.end() :]
        target = rest if rest.startswith(b"/") else b"/" + rest
    elif not target.startswith(b"/") and (request.method, target) != (b"OPTIONS", b"*"):
        raise h11.RemoteProtocolError("the target of a request needs to begin with /")
    path = unquote_to_bytes(target.partition(b"?")[0])
    if any(byte < 0x20 or byte == 0x7F for byte in path):
        raise _RefusedPath("the path has control characters", path)
    try:
        path.decode()
    except UnicodeDecodeError:
        raise _RefusedPath("the path is not UTF-8", path) from None
    if target == request.target:
        return request
    return h11.Request(method=request.method, headers=request.headers, target=target, http_version=request.http_version)


class _Transport(asyncio.Transport):
    """A transport whose `close` asks the protocol, which may have to throw away a body first."""

    def __init__(self, inner: asyncio.Transport, protocol: "BoundedProtocol") -> None:
        super().__init__()
        self._inner, self._protocol = inner, protocol

    def close(self) -> None:
        self._protocol.finish()

    def is_closing(self) -> bool:
        return self._protocol.finishing or self._inner.is_closing()

    def write(self, data: bytes | bytearray | memoryview) -> None:
        self._inner.write(data)

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return self._inner.get_extra_info(name, default)

    def pause_reading(self) -> None:
        self._inner.pause_reading()

    def resume_reading(self) -> None:
        self._inner.resume_reading()


class BoundedProtocol(H11Protocol):
    """uvicorn's HTTP/1.1 protocol with `limits`; use the subclass that `protocol_with` makes."""

    limits: ClassVar[ConnectionLimits]

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self.conn: _Connection = _Connection(h11.SERVER, MOST_HEAD_BYTES)
        self.finishing = False
        self._inner: asyncio.Transport
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._discarded = 0
        self._unsent = 0
        self._reads_slowly_since = 0.0

    # what asyncio calls

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Count the connection, and begin to wait for a request."""
        super().connection_made(transport)
        self._inner = transport
        self.transport = _Transport(transport, self)
        self.flow = FlowControl(self.transport)
        if len(self.connections) > self.limits.connections + RESERVE:
            transport.abort()
            return
        if len(self.connections) > self.limits.connections:
            self.app_state = {**self.app_state, CROWDED: True}
        self._after("head", self.limits.head_s, self._head_is_late)

    def data_received(self, data: bytes) -> None:
        """Parse bytes, or throw them away when the connection is finishing."""
        if self.finishing:
            self._discard(len(data))
            return
        answered = self.cycle
        if (answered is None or answered.response_complete) and "head" not in self._timers:
            self._after("head", self.limits.head_s, self._head_is_late)
        super().data_received(data)
        if self.cycle is not answered:
            self._cancel("head")

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop all timers."""
        self.finishing = True
        for name in list(self._timers):
            self._cancel(name)
        super().connection_lost(exc)

    def pause_writing(self) -> None:
        """The client reads more slowly than it is sent to: give it up where it reads no more."""
        super().pause_writing()
        self._reads_slowly_since = self.loop.time()
        self._watch_writing(PAUSED_S)
        self._make_room()

    def resume_writing(self) -> None:
        """The client has caught up: watch it no longer."""
        super().resume_writing()
        self._unsent = 0
        if not self.finishing:
            self._cancel("write")

    # what uvicorn calls

    def send_400_response(self, msg: str) -> None:
        """Answer what h11 refused; called while its exception is handled, whose text is better than `msg`."""
        error = sys.exc_info()[1]
        if getattr(error, "error_status_hint", 400) == _TOO_LARGE:
            self._answer("headers-too-large", f"request line and headers have more than {MOST_HEAD_BYTES:,} bytes")
        else:
            # Without the line that h11 repeats: it may hold a key or positions, which no log is to have.
            what, _, _ = str(error or msg).partition(": bytearray(")
            self._answer("bad-request", what, getattr(error, "path", ""))

    def _unsupported_upgrade_warning(self) -> None:
        """No warning: a client may ask for another protocol, and is answered in this one."""

    def shutdown(self) -> None:
        """Close an idle connection, and others once they have answered."""
        if not self.finishing:
            super().shutdown()

    # time

    def _after(self, name: str, seconds: float, call: Any) -> None:
        self._cancel(name)
        self._timers[name] = self.loop.call_later(seconds, call)

    def _cancel(self, name: str) -> None:
        if timer := self._timers.pop(name, None):
            timer.cancel()

    def _head_is_late(self) -> None:
        if self.finishing or (self.cycle is not None and not self.cycle.response_complete):
            return
        if self.conn.has_begun:
            seconds = f"{self.limits.head_s:g}"
            self._answer("request-timeout", f"request line and headers did not arrive within {seconds} s")
        else:
            self.finish()

    # answers that no route gives

    def _answer(self, code: str, detail: str, path: str = "") -> None:
        """Send a problem, unless an answer has begun, and close the connection; `path` is known of some requests."""
        if self.finishing:
            return
        request_id = secrets.token_hex(16)
        begun = self.conn.our_state is not h11.IDLE and self.conn.our_state is not h11.SEND_RESPONSE
        if self.cycle is not None and not self.cycle.response_complete:
            path = path or str(self.cycle.scope["path"])
            # The route may wait for the rest of the body, which will not come.
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        logger.info("%s: %s", code, detail, extra={"event": code, "client": self.client, "request_id": request_id})
        if begun:
            self._inner.abort()
            return
        with noting(path):
            response = problem(code, detail, request_id, headers={"Connection": "close", "X-Request-Id": request_id})
        status = HTTPStatus(response.status_code)
        lines = [b"HTTP/1.1 %d %s" % (status, status.phrase.encode())]
        lines += [name + b": " + value for name, value in (*self.server_state.default_headers, *response.raw_headers)]
        self._inner.write(b"\r\n".join((*lines, b"", bytes(response.body))))
        self._finish(unread=True)

    # closing

    def finish(self) -> None:
        """Close the connection, after throwing away what the client still sends; it gets what was written."""
        rest, _ = self.conn.trailing_data
        self._finish(unread=bool(rest) or self.conn.their_state in (h11.SEND_BODY, h11.ERROR))

    def _finish(self, *, unread: bool) -> None:
        if self.finishing:
            return
        self.finishing = True
        self._unset_keepalive_if_required()
        self._cancel("head")
        self._unsent = 0
        self._watch_writing(STALLED_S)
        if not unread or self._inner.is_closing():
            self._inner.close()
            return
        # The client sees the end of the answer while it may go on sending.
        with contextlib.suppress(OSError, RuntimeError):
            self._inner.write_eof()
        self._inner.resume_reading()
        self._after("discard", self.limits.discard_s, self._inner.close)
        self._after("silence", IDLE_S, self._inner.close)

    def _discard(self, size: int) -> None:
        self._discarded += size
        if self._discarded > self.limits.discard_bytes:
            self._inner.close()
        elif not self._inner.is_closing():
            self._after("silence", IDLE_S, self._inner.close)

    def _watch_writing(self, patience_s: float) -> None:
        """Give up a client that does not read its answer: `close` alone waits for it without end, and so does a stream.

        What it has read is told by what the system has still to send: that takes some of ours a megabyte at a time.
        """
        unsent = self._inner.get_write_buffer_size() + self._queued()
        if unsent and unsent == self._unsent:
            self._inner.abort()
            return
        self._unsent = unsent
        self._after("write", patience_s, partial(self._watch_writing, patience_s))

    def _make_room(self) -> None:
        """Give up other clients while all answers take too much memory: those that have been reading for longest, and
        last those of which little is held, such as of a snapshot, which is made as it is read."""
        unsent = {one: one._inner.get_write_buffer_size() for one in self.connections if isinstance(one, type(self))}
        total = sum(unsent.values())
        for one in sorted(unsent, key=lambda given: (unsent[given] < LITTLE_BYTES, given._reads_slowly_since)):
            if total <= self.limits.unsent_bytes:
                return
            if one is not self and unsent[one]:
                logger.info(
                    "an answer is given up: its client reads slowly, and answers take all the memory there is for them",
                    extra={"event": "answer_given_up", "client": one.client, "bytes": unsent[one]},
                )
                one._inner.abort()
                total -= unsent[one]

    def _queued(self) -> int:
        """Bytes that the system has not sent, or that were not acknowledged; 0 where it does not tell."""
        with contextlib.suppress(OSError, ValueError):  # ValueError: it is closed
            told = fcntl.ioctl(self._inner.get_extra_info("socket").fileno(), termios.TIOCOUTQ, bytes(4))
            return int.from_bytes(told, sys.byteorder)
        return 0


def protocol_with(limits: ConnectionLimits) -> type[BoundedProtocol]:
    """The protocol class for these limits: uvicorn makes the instances itself."""
    return type("LimitedProtocol", (BoundedProtocol,), {"limits": limits})
