"""One query at a time, the newest image first, and nothing that goes wrong ends it."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import httpx
import pytest
from revisit_client import Revisit
from revisit_ros.encoding import Unusable
from revisit_ros.images import Shot
from revisit_ros.localizer import Localizer
from revisit_ros.pose import Guess
from revisit_ros.settings import LOCALIZE, read

from app.http.examples import QUERY_ANSWER


class Service:
    """Answers queries when it is told to."""

    def __init__(self) -> None:
        self.bodies: list[str] = []
        self.answer: Callable[[], httpx.Response] = lambda: httpx.Response(200, json=QUERY_ANSWER)
        self.open = threading.Event()
        self.open.set()
        self.arrived = threading.Semaphore(0)

    def __call__(self, request: httpx.Request) -> httpx.Response:
        self.bodies.append(request.read().decode(errors="replace"))
        self.arrived.release()
        assert self.open.wait(60)
        return self.answer()


class Driven:
    """A localizer with a clock that is set by hand."""

    def __init__(self, service: Service, values: dict[str, Any]) -> None:
        self.now = 0.0
        self.woken = threading.Semaphore(0)
        revisit = Revisit("http://x", transport=httpx.MockTransport(service), patience=0)
        given = read(LOCALIZE, values) | {"topic": "/image/compressed"}
        self.localizer = Localizer(revisit, given, self.woken.release, lambda: self.now)

    def image(self, name: str, read: Callable[[], bytes] | None = None) -> None:
        self.localizer.image(Shot(1, 2, "camera", read or (lambda: name.encode()), self.now))

    def answers(self) -> list[str]:
        """Statuses of what came, once something did."""
        assert self.woken.acquire(timeout=60)
        return [found.answer.status for found in self.localizer.answers()]

    def value(self, name: str) -> str:
        return self.localizer.report().values[name]


@contextmanager
def driving(service: Service, **values: Any) -> Iterator[Driven]:
    driven = Driven(service, values)
    try:
        yield driven
    finally:
        service.open.set()
        driven.localizer.close()


def test_while_a_query_runs_the_newest_waits_and_older_ones_are_dropped_and_counted() -> None:
    service = Service()
    service.open.clear()
    with driving(service, rate=10) as driven:
        driven.image("image-0")
        assert service.arrived.acquire(timeout=60)
        for number in range(1, 5):
            driven.now += 0.1
            driven.image(f"image-{number}")
        assert driven.localizer.answers() == []  # nothing waits for the service
        service.open.set()
        assert driven.answers() == ["matched"]
        assert driven.answers() == ["matched"]
        assert ["image-0" in service.bodies[0], "image-4" in service.bodies[1]] == [True, True]
        assert (len(service.bodies), driven.value("images_dropped"), driven.value("images_received")) == (2, "3", "5")


def test_an_image_that_waited_too_long_is_dropped() -> None:
    service = Service()
    service.open.clear()
    with driving(service, rate=10, max_age=2) as driven:
        driven.image("image-0")
        driven.now = 0.2
        driven.image("image-1")
        driven.now = 2.3
        service.open.set()
        assert driven.answers() == ["matched"]
        assert (len(service.bodies), driven.value("images_dropped")) == (1, "1")


def test_images_beyond_the_rate_are_left() -> None:
    service = Service()
    with driving(service, rate=1) as driven:
        driven.image("image-0")
        driven.answers()
        driven.now = 0.5
        driven.image("image-1")
        driven.now = 1.0
        driven.image("image-2")
        driven.answers()
        assert ["image-2" in service.bodies[1], len(service.bodies)] == [True, 2]
        assert (driven.value("images_not_due"), driven.value("images_dropped")) == ("1", "0")


def test_a_trigger_asks_with_the_next_image_where_nothing_else_does() -> None:
    service = Service()
    with driving(service, rate=0) as driven:
        driven.image("image-0")
        assert driven.localizer.trigger() == (
            True,
            "the next image is queried with; a pose is published if it matches",
        )
        driven.image("image-1")
        assert driven.answers() == ["matched"]
        driven.image("image-2")
        assert [("image-1" in one) for one in service.bodies] == [True]


def test_a_trigger_without_images_says_so() -> None:
    with driving(Service()) as driven:
        driven.now = 60
        going, told = driven.localizer.trigger()
        assert not going
        assert "no images on /image/compressed" in told


def test_the_service_goes_and_comes_back() -> None:
    service = Service()

    def away() -> httpx.Response:
        raise httpx.ConnectError("Connection refused")

    with driving(service, rate=10) as driven:
        service.answer = away
        driven.image("image-0")
        assert driven.answers() == []
        report = driven.localizer.report()
        assert (report.level, report.values["state"]) == (2, "service away")
        assert "./revisit serve" in report.values["remedy"]
        driven.now = 0.9
        driven.image("image-1")  # not bodies: the service was away a moment ago
        assert driven.localizer.trigger()[0] is False
        service.answer = lambda: httpx.Response(200, json=QUERY_ANSWER)
        driven.now = 1.0
        driven.image("image-2")
        assert driven.answers() == ["matched"]
        assert (driven.value("state"), driven.value("queries_failed"), len(service.bodies)) == ("working", "1", 2)


def test_an_image_that_cannot_be_sent_is_told_and_the_next_one_is_sent() -> None:
    service = Service()

    def unusable() -> bytes:
        raise Unusable("images come as 'mono16': give the colour camera")

    with driving(service, rate=10) as driven:
        driven.image("image-0", unusable)
        assert driven.answers() == []
        report = driven.localizer.report()
        assert (report.level, report.message) == (1, "images come as 'mono16': give the colour camera")
        assert driven.localizer.trigger()[0]
        driven.now = 0.1
        driven.image("image-1")
        assert driven.answers() == ["matched"]


def test_whatever_is_raised_the_node_goes_on() -> None:
    service = Service()

    def broken() -> bytes:
        raise MemoryError

    with driving(service, rate=10) as driven:
        driven.image("image-0", broken)
        assert driven.answers() == []
        assert driven.value("state") == "refused"
        driven.now = 0.1
        driven.image("image-1")
        assert driven.answers() == ["matched"]


def field(body: str, name: str) -> str | None:
    _, found, rest = body.partition(f'name="{name}"\r\n\r\n')
    return rest.partition("\r\n")[0] if found else None


@pytest.mark.parametrize("used", [True, False])
def test_parameters_reach_the_service_and_a_guess_where_it_is_wanted(used: bool) -> None:
    service = Service()
    given = {"map": "campus", "precision": 0.99, "zoom": 1.5, "drive": "robot-7", "exclude_last": "30s"}
    with driving(service, use_initial_guess=used, **given) as driven:
        driven.localizer.guess(Guess(3.5, -2.0, 25.0))
        driven.image("image-0")
        driven.answers()
    (body,) = service.bodies
    assert {name: field(body, name) for name in given} == {name: str(value) for name, value in given.items()}
    assert (field(body, "near"), field(body, "frame")) == (("3.5,-2.0,25.0", "map") if used else (None, None))


def test_nothing_is_sent_that_was_not_set() -> None:
    service = Service()
    with driving(service) as driven:
        driven.image("image-0")
        driven.answers()
    assert [field(service.bodies[0], name) for name in ("precision", "zoom", "drive", "exclude_last", "near")] == [
        None
    ] * 5


def test_times_and_counts_are_told() -> None:
    service = Service()
    with driving(service) as driven:
        driven.localizer.published = 3
        driven.image("image-0")
        driven.answers()
        values = driven.localizer.report().values
    assert values["num_published_poses"] == "3"
    assert float(values["localization_execution_time"]) == 0
    assert (values["matched"], values["last_status"], values["last_confidence"]) == ("1", "matched", "0.970")
