"""A service that may start no more threads does with those it has, and says so where that is not enough."""

import threading
from concurrent.futures import Future

import pytest

from app.cli.__main__ import main
from app.http.problems import internal
from schemas.threads import NO_MORE_THREADS, Threads


@pytest.fixture
def no_more(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Lets the system refuse every further thread, as it does beyond `pids.max`."""

    def refuse(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    return monkeypatch


def test_all_is_done_by_the_thread_that_there_is(request: pytest.FixtureRequest) -> None:
    pool, ends = Threads(4, "few"), threading.Event()
    request.getfixturevalue("no_more")

    def number(one: int) -> tuple[int, str]:
        ends.wait(10)
        return one, threading.current_thread().name

    given: list[Future[tuple[int, str]]] = [pool.submit(number, one) for one in range(20)]
    ends.set()
    assert [each.result(10) for each in given] == [(one, "few_0") for one in range(20)]


def test_other_errors_are_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    pool = Threads(4, "few")

    def fail(_: threading.Thread) -> None:
        raise RuntimeError("thread already started")

    monkeypatch.setattr(threading.Thread, "start", fail)
    held = threading.Event()

    def crowd() -> None:
        for _ in range(4):
            pool.submit(held.wait)

    with pytest.raises(RuntimeError, match="already started"):
        crowd()
    held.set()
    pool.shutdown(wait=False)
    with pytest.raises(RuntimeError, match="after shutdown"):
        pool.submit(held.wait)


@pytest.mark.usefixtures("no_more")
def test_a_pool_without_any_thread_is_none() -> None:
    with pytest.raises(RuntimeError, match="can't start new thread"):
        Threads(4, "none")


def test_a_request_that_needs_a_further_thread_is_refused_for_a_while() -> None:
    answer = internal(RuntimeError("can't start new thread"), "me")
    assert (answer.status_code, answer.headers["retry-after"]) == (503, "5")
    assert NO_MORE_THREADS.encode() in answer.body
    assert internal(RuntimeError("cannot schedule new futures after shutdown"), "me").status_code == 500


def test_a_command_that_cannot_start_its_threads_says_why(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(*_: object) -> int:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr("app.cli.serve.run_serve", run)
    assert main(["serve"]) == 1
    assert f"revisit: {NO_MORE_THREADS}" in capsys.readouterr().err
