"""As many files may be open as the connections need, as far as the system allows."""

import asyncio
import errno
import logging
import resource
from typing import Any
from unittest.mock import Mock

import pytest

from app.http.open_files import LoopTrouble, allow_open_files, connections_allowed
from schemas.errors import SetupError

NONE = resource.RLIM_INFINITY


@pytest.fixture
def limits(monkeypatch: pytest.MonkeyPatch) -> dict[int, tuple[int, int]]:
    """Limits of the process, which is not this one."""
    kept = {resource.RLIMIT_NOFILE: (1024, NONE)}
    monkeypatch.setattr(resource, "getrlimit", kept.__getitem__)
    monkeypatch.setattr(resource, "setrlimit", kept.__setitem__)
    return kept


@pytest.mark.parametrize(
    ("before", "after", "served"),
    [
        ((1024, NONE), (1024, NONE), 512),  # what most systems begin with is enough
        ((256, NONE), (876, NONE), 512),  # macOS
        ((256, 4096), (876, 4096), 512),
        ((256, 600), (600, 600), 236),
        ((380, 380), (380, 380), 16),
        ((NONE, NONE), (NONE, NONE), 512),
    ],
)
def test_the_limit_is_raised_as_far_as_it_may_be(
    limits: dict[int, tuple[int, int]],
    caplog: pytest.LogCaptureFixture,
    before: tuple[int, int],
    after: tuple[int, int],
    served: int,
) -> None:
    limits[resource.RLIMIT_NOFILE] = before
    allow_open_files(512)
    assert limits[resource.RLIMIT_NOFILE] == after
    assert connections_allowed(512) == served
    warned = [record.getMessage() for record in caplog.records]
    assert len(warned) == (served < 512)
    assert all(f"{served} connections are served at once, not 512" in line for line in warned)


def test_a_service_that_could_serve_nobody_does_not_start(limits: dict[int, tuple[int, int]]) -> None:
    limits[resource.RLIMIT_NOFILE] = (100, 379)
    with pytest.raises(SetupError, match=r"may have 379 open files here \(ulimit -Hn\), and serving takes 380"):
        allow_open_files(512)
    allow_open_files(10)  # who wants few connections needs fewer


def test_a_shortage_of_open_files_is_said_once_a_minute(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    now = 0.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    loop, trouble = Mock(spec=asyncio.AbstractEventLoop), LoopTrouble()
    short: dict[str, Any] = {
        "message": "socket.accept() out of system resource",
        "exception": OSError(errno.EMFILE, "Too many open files"),
    }
    for _ in range(2048):
        trouble(loop, short)
    assert [record.levelno for record in caplog.records] == [logging.ERROR]
    assert "Too many open files" in caplog.text
    now = 61.0
    trouble(loop, short)
    assert len(caplog.records) == 2
    loop.default_exception_handler.assert_not_called()


def test_all_other_trouble_is_told_as_ever() -> None:
    loop, trouble = Mock(spec=asyncio.AbstractEventLoop), LoopTrouble()
    others: list[dict[str, Any]] = [
        {"message": "Task was destroyed but it is pending!"},
        {"message": "Exception in callback answer()", "exception": ValueError("no")},
        {"message": "Exception in callback read()", "exception": OSError(errno.EMFILE, "Too many open files")},
    ]
    for context in others:
        trouble(loop, context)
    assert [call.args for call in loop.default_exception_handler.call_args_list] == [(one,) for one in others]
