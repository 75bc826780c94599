"""Every so many metres a view, none twice, and none lost while the service is away."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import httpx
from revisit_client import Revisit
from revisit_ros.enroller import MOST_FAILURES, Enroller
from revisit_ros.frames import Transform
from revisit_ros.images import Shot
from revisit_ros.settings import ENROLL, read

from tests.answers import enrolled
from tests.ros2.test_localizer import field

OPTICAL = (-0.5, 0.5, -0.5, 0.5)


class Service:
    """Enrols, once it is told what to answer."""

    def __init__(self) -> None:
        self.bodies: list[str] = []
        self.keys: list[str] = []
        self.answer: Callable[[], httpx.Response] = lambda: httpx.Response(201, json=enrolled())

    def __call__(self, request: httpx.Request) -> httpx.Response:
        self.bodies.append(request.read().decode(errors="replace"))
        self.keys.append(request.headers["idempotency-key"])
        return self.answer()


class Driven:
    """An enroller with a clock and poses that are set by hand."""

    def __init__(self, service: Service, values: dict[str, Any]) -> None:
        self.now = 0.0
        self.camera: Transform | None = Transform(0, 0, 0, *OPTICAL)
        self.woken = threading.Semaphore(0)
        revisit = Revisit("http://x", transport=httpx.MockTransport(service), patience=0)
        given = read(ENROLL, values) | {"topic": "/image"}
        self.enroller = Enroller(revisit, given, lambda shot: self.camera, self.woken.release, lambda: self.now)

    def image(self, x: float = 0.0, *, seconds: int = 1_800_000_000, after: float = 1.0) -> None:
        self.now += after
        if self.camera is not None:
            self.camera = Transform(x, 2.0, 0.5, *OPTICAL)
        self.enroller.image(Shot(seconds, 250_000_000, "camera", lambda: b"jpeg", self.now))

    def done(self) -> int:
        """How many were enrolled, once something came back."""
        assert self.woken.acquire(timeout=60)
        return len(self.enroller.enrolled())

    def value(self, name: str) -> str:
        return self.enroller.report().values[name]


@contextmanager
def driving(service: Service, **values: Any) -> Iterator[Driven]:
    driven = Driven(service, values)
    try:
        yield driven
    finally:
        driven.enroller.close()


def test_a_view_has_the_position_the_heading_and_the_time_of_its_image() -> None:
    service = Service()
    with driving(service, map="campus", place="hall") as driven:
        driven.image(3.0)
        assert driven.done() == 1
        assert driven.value("enrolled") == "1"
    (body,) = service.bodies
    told = {name: field(body, name) for name in ("map", "place", "x", "y", "z", "heading", "captured_at")}
    # The camera looks along +x, which is east.
    assert told == {
        "map": "campus",
        "place": "hall",
        "x": "3.0",
        "y": "2.0",
        "z": "0.5",
        "heading": "90.0",
        "captured_at": "2027-01-15T08:00:00.250000Z",
    }
    assert field(body, "metadata") == '{"stamp": "1800000000.250000000", "frame": "camera"}'


def test_the_clock_of_a_simulation_is_no_time_of_day() -> None:
    service = Service()
    with driving(service) as driven:
        driven.image(seconds=12)
        driven.done()
    assert field(service.bodies[0], "captured_at") is None
    assert '"12.250000000"' in (field(service.bodies[0], "metadata") or "")


def test_standing_still_enrols_once() -> None:
    service = Service()
    with driving(service, every_metres=1) as driven:
        for x in (0.0, 0.0, 0.4, 0.9, 1.0, 1.9, 2.1):
            driven.image(x)
        assert [driven.done() for _ in range(3)] == [1, 1, 1]
        assert driven.value("views_waiting") == "0"
    assert [field(body, "x") for body in service.bodies] == ["0.0", "1.0", "2.1"]


def test_a_turn_on_the_spot_is_a_view_too() -> None:
    service = Service()
    with driving(service, every_degrees=45) as driven:
        driven.image()
        driven.done()
        driven.camera = Transform(0, 2, 0.5, 0, 0.5**0.5, 0, 0.5**0.5)  # z of the frame along +x: as before
        driven.now += 1
        driven.enroller.image(Shot(1, 0, "camera", lambda: b"jpeg", driven.now))
        driven.camera = Transform(0, 2, 0.5, -(0.5**0.5), 0, 0, 0.5**0.5)  # along +y
        driven.now += 1
        driven.enroller.image(Shot(2, 0, "camera", lambda: b"jpeg", driven.now))
        driven.done()
    assert [field(body, "heading") for body in service.bodies] == ["90.0", "0.0"]


def test_an_image_waits_for_its_transform_and_no_longer_than_it_may() -> None:
    service = Service()
    with driving(service, tf_wait=1, silence=60) as driven:
        driven.camera = None
        driven.image()
        driven.now += 0.5
        driven.enroller.go_on()
        assert service.bodies == []
        driven.camera = Transform(7.0, 0, 0, *OPTICAL)
        driven.enroller.go_on()
        assert driven.done() == 1
        driven.camera = None
        driven.enroller.note = "no transform"
        driven.image()
        driven.now += 1.1
        driven.enroller.go_on()
        report = driven.enroller.report()
        assert (report.level, report.message, report.values["images_without_transform"]) == (1, "no transform", "1")
        driven.camera = Transform(9, 0, 0, *OPTICAL)
        driven.image(9.0)
        assert driven.done() == 1
        assert driven.enroller.report().level == 0
    assert [field(body, "x") for body in service.bodies] == ["7.0", "9.0"]


def test_views_wait_while_the_service_is_away_and_the_oldest_give_way() -> None:
    service = Service()

    def away() -> httpx.Response:
        raise httpx.ConnectError("Connection refused")

    with driving(service, queue=2, rate=100, silence=600) as driven:
        service.answer = away
        driven.image(0.0)
        assert driven.done() == 0
        assert (driven.value("state"), driven.value("views_waiting")) == ("service away", "1")
        for x in (1.0, 2.0, 3.0):
            driven.image(x, after=0.1)
        assert (driven.value("views_waiting"), driven.value("views_dropped")) == ("2", "2")
        service.answer = lambda: httpx.Response(201, json=enrolled())
        driven.now += 60
        driven.enroller.go_on()
        assert [driven.done(), driven.done()] == [1, 1]
        assert (driven.value("state"), driven.value("views_waiting")) == ("working", "0")
    assert [field(body, "x") for body in service.bodies] == ["0.0", "2.0", "3.0"]


def test_the_same_view_has_the_same_key_however_often_it_is_sent() -> None:
    service = Service()
    busy = {"type": "urn:revisit:too-many-requests", "title": "No", "status": 429, "detail": "", "request_id": "r"}
    with driving(service, silence=60) as driven:
        service.answer = lambda: httpx.Response(429, json=busy, headers={"retry-after": "2"})
        driven.image()
        assert driven.done() == 0
        driven.now += 1.9
        driven.enroller.go_on()
        assert len(service.bodies) == 1
        service.answer = lambda: httpx.Response(201, json=enrolled())
        driven.now += 0.2
        driven.enroller.go_on()
        assert driven.done() == 1
    assert len(service.keys) == 2
    assert len(set(service.keys)) == 1


def test_an_image_that_the_service_refuses_is_counted_and_not_sent_again() -> None:
    service = Service()
    refused = {"type": "urn:revisit:nothing-static", "title": "No", "status": 422, "detail": "a wall of cars"}
    with driving(service) as driven:
        service.answer = lambda: httpx.Response(422, json=refused | {"request_id": "r"})
        driven.image()
        assert driven.done() == 0
        report = driven.enroller.report()
        assert (report.level, report.values["refused"], report.values["views_waiting"]) == (1, "1", "0")
        assert "a wall of cars" in report.message


def test_warnings_of_the_service_are_told() -> None:
    service = Service()
    warned = enrolled() | {"warnings": [{"code": "poor-picture", "detail": "dark", "remedy": "light"}]}
    with driving(service) as driven:
        service.answer = lambda: httpx.Response(201, json=warned)
        driven.image()
        assert driven.done() == 1
        assert (driven.value("warned_of"), driven.value("last_warning")) == ("1", "poor-picture")


def test_an_image_that_the_map_has_with_another_position_does_not_hold_up_the_next() -> None:
    """A camera that hangs sends the same bytes for ever, as does a recording that is played again."""
    service = Service()
    conflict = {"type": "urn:revisit:problem:conflict", "title": "No", "status": 409, "detail": "x", "request_id": "r"}

    def of_the_map() -> httpx.Response:
        replayed = {"idempotent-replayed": "true"} if service.keys.count(service.keys[-1]) > 1 else {}
        return httpx.Response(409, json=conflict, headers=replayed)

    with driving(service, silence=60) as driven:
        service.answer = of_the_map
        driven.image(0.0)
        assert driven.done() == 0
        assert driven.value("state") == "service busy"  # an earlier call may have sent it, and still run
        driven.now += 1
        driven.enroller.go_on()
        assert driven.done() == 0
        assert (driven.value("state"), driven.value("refused")) == ("image refused", "1")
        service.answer = lambda: httpx.Response(201, json=enrolled())
        driven.image(3.0)
        assert driven.done() == 1
    assert [field(body, "x") for body in service.bodies] == ["0.0", "0.0", "3.0"]


def test_an_image_whose_call_ended_with_its_node_does_not_hold_up_the_next() -> None:
    """Of a fleet: another node takes the call that was killed for one that runs, for ten minutes."""
    service = Service()
    runs = {"type": "urn:revisit:problem:conflict", "title": "No", "status": 409, "detail": "runs", "request_id": "r"}

    def killed() -> httpx.Response:
        raise httpx.ReadError("the node was killed")

    def other_node() -> httpx.Response:
        first = service.keys[-1] == service.keys[0]
        return httpx.Response(409, json=runs) if first else httpx.Response(201, json=enrolled())

    with driving(service, silence=600) as driven:
        service.answer = killed
        driven.image(0.0)
        assert driven.done() == 0
        service.answer = other_node
        for enrolled_by_now in (0, 0, 1):
            driven.now += 30
            driven.enroller.go_on()
            assert driven.done() == enrolled_by_now
        driven.image(3.0)
        assert driven.done() == 1
        assert driven.value("refused") == "0"
    assert [field(body, "x") for body in service.bodies] == ["0.0"] * 4 + ["3.0"]
    assert len(set(service.keys[:3])) == 1


def test_an_image_on_which_the_service_fails_each_time_is_left_out() -> None:
    service = Service()
    failed = {"type": "urn:revisit:problem:internal", "title": "No", "status": 500, "detail": "x", "request_id": "r"}
    with driving(service, silence=600) as driven:
        service.answer = lambda: httpx.Response(500, json=failed)
        driven.image(0.0)
        for _ in range(MOST_FAILURES - 1):
            assert driven.done() == 0
            assert driven.value("views_waiting") == "1"
            driven.now += 60
            driven.enroller.go_on()
        assert driven.done() == 0
        assert (driven.value("refused"), driven.value("views_waiting")) == ("1", "0")
        service.answer = lambda: httpx.Response(201, json=enrolled())
        driven.image(3.0, after=60)
        assert driven.done() == 1
    assert [field(body, "x") for body in service.bodies] == ["0.0"] * MOST_FAILURES + ["3.0"]
