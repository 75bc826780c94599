"""What `serve` refuses before anything is loaded."""

import asyncio
import socket

import pytest

from app.cli.__main__ import main
from app.cli.listening import listen
from schemas.settings import Settings

Out = pytest.CaptureFixture[str]


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.5", "::", "robot.local"])
def test_an_address_that_others_reach_needs_open(host: str, capsys: Out) -> None:
    assert main(["serve", "--host", host]) == 2
    assert "--open" in capsys.readouterr().err


def test_a_taken_port_is_said_at_once(capsys: Out) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]

        assert main(["serve", "--port", str(port)]) == 1

    error = capsys.readouterr().err
    assert str(port) in error
    assert "--port" in error


def test_an_unknown_setting_is_wrong_use_with_the_nearest_name(monkeypatch: pytest.MonkeyPatch, capsys: Out) -> None:
    monkeypatch.setenv("REVISIT_TREADS", "2")

    assert main(["serve"]) == 2
    assert "REVISIT_THREADS" in capsys.readouterr().err


def test_a_value_out_of_range_is_wrong_use(capsys: Out) -> None:
    assert main(["serve", "--port", "99999"]) == 2
    assert "REVISIT_PORT" in capsys.readouterr().err


def test_answers_do_not_wait_for_the_acknowledgement_of_their_headers() -> None:
    """Without TCP_NODELAY the second of two writes waits some 40 ms, on every request of a connection kept open."""

    async def story() -> int:
        seen: asyncio.Future[int] = asyncio.get_running_loop().create_future()

        def accepted(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            mine = writer.get_extra_info("socket")
            seen.set_result(mine.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        with listen(Settings(port=0)) as listening:
            server = await asyncio.start_server(accepted, sock=listening)
            async with server:
                _, writer = await asyncio.open_connection(*listening.getsockname()[:2])
                delay_off = await seen
                writer.close()
                await writer.wait_closed()
            return delay_off

    assert asyncio.run(story()) != 0
