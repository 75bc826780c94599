"""One connection on a small application: what takes too long against a real process is tried here with short times."""

import asyncio
import contextlib
import json
import logging
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.server import ServerState

from app.http.connection import protocol_with
from app.http.limits import RESERVE, ConnectionLimits
from app.http.server import configured
from schemas.settings import Settings

LARGE = b"x" * 50_000_000
PIECE = 1_000_000
ASK = b"GET / HTTP/1.1\r\nHost: a\r\n"


async def streamed(scope: Scope, receive: Receive, send: Send) -> None:
    """As a snapshot: each piece is sent when there is room for it."""
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"%d" % len(LARGE))]})
    for begin in range(0, len(LARGE), PIECE):
        await send({"type": "http.response.body", "body": LARGE[begin : begin + PIECE], "more_body": True})
    await send({"type": "http.response.body"})


async def large(scope: Scope, receive: Receive, send: Send) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"%d" % len(LARGE))]})
    await send({"type": "http.response.body", "body": LARGE})


@asynccontextmanager
async def listening(
    connections: int = 10, app: ASGIApp = large, head_s: float = 5, unsent_bytes: int = 10**9
) -> AsyncIterator[tuple[ServerState, int]]:
    """A server of the application on a free port; its connections stand in the state."""
    config = configured(app, Settings())
    config.load()
    state = ServerState()
    made = protocol_with(
        ConnectionLimits(connections, head_s, discard_s=5, discard_bytes=1000, unsent_bytes=unsent_bytes)
    )
    server = await asyncio.get_running_loop().create_server(lambda: made(config, state, {}), "127.0.0.1", 0)
    async with server:
        yield state, server.sockets[0].getsockname()[1]
        for connection in list(state.connections):
            connection.transport.close()


async def gone(state: ServerState) -> None:
    async with asyncio.timeout(20):
        while state.connections:
            await asyncio.sleep(0.02)


async def ended(reader: asyncio.StreamReader) -> bool:
    """Whether the connection is closed or reset without a byte."""
    try:
        return await asyncio.wait_for(reader.read(1), 20) == b""
    except ConnectionError:
        return True


def small_window() -> socket.socket:
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.setblocking(False)
    return connection


APPS = pytest.mark.parametrize("app", [large, streamed])


@APPS
def test_a_client_that_does_not_read_its_answer_is_given_up(monkeypatch: pytest.MonkeyPatch, app: ASGIApp) -> None:
    monkeypatch.setattr("app.http.connection.STALLED_S", 0.2)
    monkeypatch.setattr("app.http.connection.PAUSED_S", 0.2)

    async def story() -> None:
        async with listening(app=app) as (state, port):
            with small_window() as connection:
                loop = asyncio.get_running_loop()
                await loop.sock_connect(connection, ("127.0.0.1", port))
                await loop.sock_sendall(connection, ASK + b"Connection: close\r\n\r\n")
                async with asyncio.timeout(20):
                    while not state.connections:
                        await asyncio.sleep(0.02)
                await gone(state)

    asyncio.run(story())


@APPS
def test_a_client_that_reads_slowly_gets_all_of_it(monkeypatch: pytest.MonkeyPatch, app: ASGIApp) -> None:
    stalled_s = 1.0
    monkeypatch.setattr("app.http.connection.STALLED_S", stalled_s)
    monkeypatch.setattr("app.http.connection.PAUSED_S", stalled_s)

    async def story() -> None:
        async with listening(app=app) as (state, port):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(ASK + b"Connection: close\r\n\r\n")
            await reader.readuntil(b"\r\n\r\n")
            size, began = 0, asyncio.get_running_loop().time()
            while piece := await reader.read(1_000_000):
                size += len(piece)
                await asyncio.sleep(0.01)
            assert size == len(LARGE)
            assert asyncio.get_running_loop().time() - began > stalled_s, "the whole takes longer than no progress may"
            writer.close()
            await gone(state)

    asyncio.run(story())


async def either(scope: Scope, receive: Receive, send: Send) -> None:
    await (streamed if scope["path"] == "/snapshot" else large)(scope, receive, send)


async def reading(port: int, path: str = "/") -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """A client that has read the head of its answer, and nothing else."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=4096)
    writer.write(f"GET {path} HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n".encode())
    await reader.readuntil(b"\r\n\r\n")
    return reader, writer


async def all_read(reader: asyncio.StreamReader) -> int:
    """Bytes until an answer ends or breaks off."""
    size = 0
    with contextlib.suppress(ConnectionError):
        while piece := await asyncio.wait_for(reader.read(1_000_000), 20):
            size += len(piece)
    return size


def test_where_answers_take_too_much_memory_whoever_reads_for_longest_is_given_up(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO, "revisit.http")

    async def story() -> list[int]:
        async with listening(unsent_bytes=2 * len(LARGE)) as (state, port):
            clients = [await reading(port) for _ in range(3)]
            sizes = [await all_read(reader) for reader, _ in clients]
            for _, writer in clients:
                writer.close()
            await gone(state)
        return sizes

    first, *others = asyncio.run(story())
    assert first < len(LARGE)  # it ends before what its Content-Length says
    assert others == [len(LARGE)] * 2
    assert [vars(line)["event"] for line in caplog.records] == ["answer_given_up"]


def test_a_snapshot_goes_on_where_other_answers_are_given_up() -> None:
    """It is made as it is read, and holds little, however long that takes."""

    async def story() -> list[int]:
        async with listening(app=either, unsent_bytes=2 * len(LARGE)) as (_, port):
            clients = [await reading(port, path) for path in ("/snapshot", "/", "/", "/")]
            sizes = [await all_read(reader) for reader, _ in clients]
            for _, writer in clients:
                writer.close()
        return sizes

    snapshot, first, *_ = asyncio.run(story())
    assert snapshot == len(LARGE)
    assert first < len(LARGE)


def test_an_answer_has_room_however_large_it_is() -> None:
    async def story() -> int:
        async with listening(unsent_bytes=1) as (_, port):
            reader, writer = await reading(port)
            await asyncio.sleep(0.2)
            size = await all_read(reader)
            writer.close()
        return size

    assert asyncio.run(story()) == len(LARGE)


@pytest.mark.parametrize(
    ("path", "further"),
    [("/maps/%01", set()), ("/compat/compreface/%01/api", {"message"}), ("/localize/geopose%01", {"ERROR"})],
)
def test_what_no_route_sees_is_refused_in_the_words_of_its_protocol_too(path: str, further: set[str]) -> None:
    """A client of CompreFace shows ``message`` and nothing else."""

    async def story() -> dict[str, str]:
        async with listening() as (_, port):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(f"GET {path} HTTP/1.1\r\nHost: a\r\n\r\n".encode())
            answer = await asyncio.wait_for(reader.read(), 20)
            writer.close()
        return dict(json.loads(answer.partition(b"\r\n\r\n")[2]))

    body = asyncio.run(story())
    assert body["detail"] == "the path has control characters"
    assert {name for name in ("message", "ERROR") if body.get(name) == body["detail"]} == further


@pytest.mark.parametrize(
    ("lines", "detail"),
    [
        (b"GET /maps HTTP/1.1\r\nHost: a\r\nX-Api-Key : rv_secret\r\n", "illegal header line"),
        (b"GET /maps HTTP/1.1\r\nHost: a\r\nAuthorization: Bearer rv_secret\0\r\n", "illegal header line"),
        (b"GET /views?near=rv_secret,2,3 4 HTTP/1.1\r\nHost: a\r\n", "illegal request line"),
    ],
)
def test_a_line_that_cannot_be_read_is_repeated_nowhere(
    lines: bytes, detail: str, caplog: pytest.LogCaptureFixture
) -> None:
    """It may hold a key, or a position."""
    caplog.set_level(logging.DEBUG)

    async def story() -> bytes:
        async with listening() as (_, port):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(lines + b"\r\n")
            answer = await asyncio.wait_for(reader.read(), 20)
            writer.close()
        return answer

    answer = asyncio.run(story())
    assert json.loads(answer.partition(b"\r\n\r\n")[2])["detail"] == detail
    logged = [record.getMessage() for record in caplog.records]
    assert f"bad-request: {detail}" in logged
    assert "rv_secret" not in f"{answer!r}{logged}"


def test_far_beyond_the_bound_connections_are_closed_unread() -> None:
    async def story() -> None:
        async with listening(connections=1) as (state, port):
            held = [await asyncio.open_connection("127.0.0.1", port) for _ in range(1 + RESERVE)]
            async with asyncio.timeout(20):
                while len(state.connections) < len(held):
                    await asyncio.sleep(0.02)
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            assert await ended(reader)
            for _, open_writer in (*held, (reader, writer)):
                open_writer.close()
            await gone(state)

    asyncio.run(story())


async def small(scope: Scope, receive: Receive, send: Send) -> None:
    """Answers the body that came."""
    body = b""
    while (message := await receive()).get("more_body", False):
        body += message["body"]
    body += message.get("body", b"")
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"%d" % len(body))]})
    await send({"type": "http.response.body", "body": body})


@pytest.mark.parametrize("at_once", [True, False])
def test_an_empty_line_behind_a_body_is_no_request(at_once: bool) -> None:
    """As small clients send it that write the end of a multipart body by hand."""
    post = b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 4\r\n\r\nbody\r\n"

    async def story() -> list[bytes]:
        async with listening(app=small) as (_, port):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            answers = []
            writer.write(b"\r\n" + post * (3 if at_once else 1))
            for number in range(3):
                answers.append(await asyncio.wait_for(reader.readuntil(b"\r\n\r\nbody"), 20))
                if not at_once and number < 2:
                    writer.write(post)
            writer.close()
            return answers

    assert [answer.partition(b"\r\n")[0] for answer in asyncio.run(story())] == [b"HTTP/1.1 200 OK"] * 3


def test_who_sends_nothing_but_empty_lines_is_not_told_of_a_request() -> None:
    async def story() -> bytes:
        async with listening(app=small, head_s=0.3) as (_, port):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(b"\r\n")
            answer = await asyncio.wait_for(reader.read(), 20)
            writer.close()
            return answer

    assert asyncio.run(story()) == b""
