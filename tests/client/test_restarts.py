"""The client waits for a service that answered before: it may be starting again."""

import logging
from contextlib import nullcontext
from threading import Event

import httpx
import pytest
from revisit_client import RevisitProblem, Unreachable

from tests import answers
from tests.client.test_client import Clock, Handler, client, refused
from tests.client.test_repetition import CLOSED, Broken, in_turn


def unless(closed: Event, answer: httpx.Response) -> Handler:
    """The same answer for ever, unless the port is closed."""

    def handler(request: httpx.Request) -> httpx.Response:
        if closed.is_set():
            raise httpx.ConnectError(CLOSED)
        return answer

    return handler


@pytest.mark.parametrize("status", [429, 503])
def test_a_service_that_was_there_just_now_is_waited_for(status: int) -> None:
    """It says that it stops, and then its port is closed until it has started again."""
    closed = httpx.ConnectError(CLOSED)
    handler = in_turn(refused("unavailable", status), closed, closed, httpx.Response(201, json=answers.enrolled()))

    assert client(handler).enroll(b"image").created


def test_a_service_that_starts_again_under_a_call_is_waited_for() -> None:
    clock = Clock()
    handler = in_turn(
        httpx.RemoteProtocolError("Server disconnected without sending a response."),
        httpx.ConnectError(CLOSED),
        refused("unavailable", 503),
        httpx.Response(201, json=answers.enrolled()),
    )

    assert client(handler, clock).enroll(b"x").created
    assert clock.naps == [0.25, 0.5, 1.0]


def test_a_service_that_starts_again_between_two_pages_or_looks_is_waited_for() -> None:
    """A list of many views and a long job are one call each, whatever lies between the requests that it takes."""
    closed = httpx.ConnectError(CLOSED)
    pages = [
        httpx.Response(200, json={"views": [answers.view(one)], "next": more})
        for one, more in (("a", "b"), ("b", None))
    ]
    handler = in_turn(pages[0], closed, closed, pages[1])

    assert [view.id for view in client(handler).views("walk")] == ["a", "b"]

    events = {"content-type": "text/event-stream"}
    broken = httpx.Response(200, headers=events, stream=Broken(b": alive\n\n"))
    handler = in_turn(
        httpx.Response(200, json=answers.job()), broken, closed, httpx.Response(200, json=answers.job("done"))
    )

    assert client(handler).wait_for_job("j1").state == "done"


def test_a_service_that_starts_again_between_two_calls_is_waited_for() -> None:
    """As between two images of a drive."""
    closed, found = httpx.ConnectError(CLOSED), httpx.Response(200, json=answers.query_answer())
    clock = Clock()
    revisit = client(in_turn(found, closed, closed, refused("unavailable", 503), found), clock)

    assert revisit.query(b"one").query == revisit.query(b"two").query
    assert clock.naps == [0.25, 0.5, 1.0]


def test_a_service_that_was_waited_for_in_vain_is_waited_for_once_it_has_answered() -> None:
    clock, closed, waited = Clock(), Event(), list[bool]()
    revisit = client(unless(closed, httpx.Response(200, json={"maps": []})), clock, patience=10)

    for away in (True, False, True, True, False, True):
        (closed.set if away else closed.clear)()
        began = clock.now
        with pytest.raises(Unreachable, match="refused") if away else nullcontext():
            revisit.maps()
        waited.append(clock.now > began)

    assert waited == [False, False, True, False, False, True]


@pytest.mark.parametrize("busy", [429, 503])
def test_a_service_that_was_busy_for_long_is_there(busy: int) -> None:
    clock, closed = Clock(), Event()
    revisit = client(unless(closed, refused("unavailable", busy)), clock, patience=10)

    with pytest.raises(RevisitProblem):
        revisit.maps()
    closed.set()
    began = clock.now
    with pytest.raises(Unreachable):
        revisit.maps()
    assert clock.now > began


def test_each_time_that_a_service_is_waited_for_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    closed, cut = httpx.ConnectError(CLOSED), httpx.ReadError("connection reset")
    stopped = refused("unavailable", 503), closed, closed
    found = httpx.Response(200, json={"maps": []})
    revisit = client(in_turn(found, *stopped, found, cut, found, refused("unavailable", 503), found))

    with caplog.at_level(logging.WARNING, "revisit_client"):
        for _ in range(4):
            revisit.maps()

    assert caplog.messages == [
        "http://test does not answer (connection refused); it is waited for, at most 60 s",
        "http://test does not answer (connection reset); it is waited for, at most 60 s",
    ]


@pytest.mark.parametrize("status", [502, 504])
def test_a_gateway_that_does_not_reach_the_service_is_repeated_where_that_was_just_there(status: int) -> None:
    """A job runs for hours behind a load balancer, and the service is updated meanwhile."""
    away = httpx.Response(status, text="<html>gateway</html>")
    handler = in_turn(
        httpx.Response(200, json=answers.job()), away, away, httpx.Response(200, json=answers.job("done"))
    )
    assert client(handler, Clock()).wait_for_job("j1").state == "done"

    cut = httpx.ReadError("the gateway is told to let go")
    assert client(in_turn(cut, away, httpx.Response(201, json=answers.enrolled())), Clock()).enroll(b"x").created

    with pytest.raises(RevisitProblem, match=f"HTTP {status}"):  # nobody was there before
        client(in_turn(away)).query(b"x")
    with pytest.raises(RevisitProblem, match=f"HTTP {status}"):  # may have been done
        client(in_turn(refused("unavailable", 503), away), Clock()).make_snapshot("town")
