"""Limits a minute: what a client may send, what all may, and when to come back."""

import math
from typing import Any

import pytest
from hypothesis import given, strategies as st

from app.http.rate_limits import MOST_BUCKETS, Buckets, client_of
from schemas.keys import Rates
from schemas.settings import Settings
from tests.http.fakes import FakeRuntime
from tests.keys_in_memory import KeyMaker
from tests.openapi import CheckedClient
from tests.sample_images import drawn, encoded

JPEG = {"content-type": "image/jpeg"}


class Seconds:
    """A clock that is set by hand."""

    now = 1000.0

    def __call__(self) -> float:
        return self.now


@given(
    limit=st.integers(1, 200),
    steps=st.lists(st.tuples(st.floats(0, 90), st.integers(1, 50)), min_size=1, max_size=60),
)
def test_no_span_lets_in_more_than_a_minutes_worth_and_its_rate(limit: int, steps: list[tuple[float, int]]) -> None:
    clock = Seconds()
    buckets = Buckets(clock)
    let_in: list[tuple[float, int]] = []
    for pause, cost in steps:
        clock.now += pause
        cost = min(cost, limit)
        if not buckets.take("a", limit, cost):
            let_in.append((clock.now, cost))
    for first, (begin, _) in enumerate(let_in):
        total = 0
        for end, cost in let_in[first:]:
            total += cost
            assert total <= limit * (1 + (end - begin) / 60) + 1e-6


@given(limit=st.integers(1, 500), cost=st.integers(1, 500), before=st.integers(0, 500))
def test_the_wait_is_enough_and_a_second_less_is_not(limit: int, cost: int, before: int) -> None:
    clock = Seconds()
    buckets = Buckets(clock)
    buckets.spend("a", limit, before)
    wait = buckets.wait("a", limit, cost)
    if wait:
        clock.now += wait - 1
        assert buckets.wait("a", limit, cost) == 1
        clock.now += 1
    assert buckets.wait("a", limit, cost) == 0


def test_what_costs_more_than_a_minute_allows_is_let_in_and_paid_off() -> None:
    clock = Seconds()
    buckets = Buckets(clock)
    assert buckets.take("a", 10, 25) == 0
    assert buckets.wait("a", 10, 1) == math.ceil(60 * 25 / 10 + 6 - 60)


def test_buckets_are_bounded_and_the_quietest_is_forgotten() -> None:
    buckets = Buckets(Seconds())
    buckets.take("first", 1, 1)
    for number in range(MOST_BUCKETS):
        buckets.take(str(number), 1, 1)
    assert len(buckets) == MOST_BUCKETS
    assert buckets.wait("first", 1, 1) == 0
    assert buckets.wait(str(MOST_BUCKETS - 1), 1, 1) > 0


@pytest.mark.parametrize(
    ("host", "client"),
    [
        ("192.0.2.1", "192.0.2.1"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("2001:db8:1:2::ffff", "2001:db8:1:2::/64"),
        ("testclient", "testclient"),
        ("::ffff:192.0.2.1", "192.0.2.1"),  # as a socket on :: sees it
    ],
)
def test_an_ipv6_network_is_one_client(host: str, client: str) -> None:
    assert client_of({"type": "http", "client": (host, 1)}) == client


def limited(keys: KeyMaker | None = None, **limits: float) -> CheckedClient:
    fake = FakeRuntime(settings=Settings(max_body_mb=2, max_megapixels=1, **limits))  # type: ignore[arg-type]
    if keys is not None:
        fake.keys = keys.service
    return CheckedClient(fake.app())


@pytest.fixture
def keys() -> KeyMaker:
    return KeyMaker()


def test_requests_beyond_the_limit_are_told_when_to_come_back() -> None:
    with limited(limit_requests=3) as client:
        answers = [client.get("/maps") for _ in range(5)]
        assert [answer.status_code for answer in answers] == [200, 200, 200, 429, 429]
        assert answers[0].headers["ratelimit-policy"] == '"requests";q=3;w=60'
        assert answers[0].headers["ratelimit"].startswith('"requests";r=2;t=')
        assert answers[-1].headers["ratelimit"].startswith('"requests";r=0;t=')
        assert 1 <= int(answers[-1].headers["retry-after"]) <= 20
        assert answers[-1].json()["type"] == "urn:revisit:problem:too-many-requests"
        assert client.get("/livez").status_code == 200  # or a supervisor would restart a busy service


def test_without_limits_nothing_is_counted_or_said() -> None:
    with limited() as client:
        assert "ratelimit-policy" not in client.get("/maps").headers


def test_each_key_has_its_own_share_and_may_have_its_own_limit(keys: KeyMaker) -> None:
    one, two = keys.make("one", "read"), keys.make("two", "read")
    robot = keys.make("robot", "read", rates=Rates(requests=4))
    free = keys.make("free", "read", rates=Rates(requests=0))
    with limited(keys, limit_requests=2) as client:

        def statuses(key: str) -> list[int]:
            return [client.get("/maps", headers={"x-api-key": key}).status_code for _ in range(5)]

        assert statuses(one) == [200, 200, 429, 429, 429]
        assert statuses(two) == [200, 200, 429, 429, 429]
        assert statuses(robot) == [200, 200, 200, 200, 429]
        assert statuses(free) == [200] * 5


def test_all_clients_together_have_a_limit(keys: KeyMaker) -> None:
    with limited(keys, limit_all_requests=3) as client:
        made = [keys.make(f"k{number}", "read") for number in range(4)]
        answers = [client.get("/maps", headers={"x-api-key": key}) for key in made]
    assert [answer.status_code for answer in answers] == [200, 200, 200, 429]
    assert "all clients together" in answers[-1].json()["detail"]


def test_what_is_refused_is_not_counted() -> None:
    """Or a client that tries again and again would never get in."""
    with limited(limit_requests=2, limit_images=1) as client:
        image = encoded(drawn(64, 64), "jpeg")
        sent: Any = {"content": image, "headers": JPEG}
        assert client.post("/enroll", **sent).status_code == 201
        assert [client.post("/query", **sent).status_code for _ in range(3)] == [429] * 3
        assert client.get("/maps").status_code == 200


def test_a_refusal_is_counted_as_one_of_the_rate_and_not_of_the_queue() -> None:
    image: Any = {"content": encoded(drawn(64, 64), "jpeg"), "headers": JPEG}
    with limited(limit_images=1) as client:
        assert [client.post("/enroll", **image).status_code for _ in range(2)] == [201, 429]
        assert 'revisit_rejected_total{reason="rate"} 1.0' in client.get("/metrics").text


def test_images_of_one_body_are_all_counted() -> None:
    with limited(limit_images=3) as client:
        files = [("image", (f"{n}.jpg", encoded(drawn(64, 64, n), "jpeg"))) for n in range(3)]
        assert client.post("/enroll", files=files).status_code == 201
        answer = client.post("/query", content=files[0][1][1], headers=JPEG)
        assert answer.status_code == 429
        assert "3 images a minute" in answer.json()["detail"]


@pytest.mark.parametrize("path", ["/views/{}/changes?since={}", "/views/{}/changes.png?since={}", "/queries/1/changes"])
def test_a_comparison_of_stored_images_counts_as_an_image(path: str) -> None:
    image = encoded(drawn(64, 64), "jpeg")
    with limited(limit_images=2) as client:
        view = client.post("/enroll", content=image, headers=JPEG).json()["view"]["id"]
        answers = [client.get(path.format(view, view)).status_code for _ in range(3)]
        assert 429 not in answers[:1]
        assert answers[1:] == [429, 429]
        assert client.get(f"/views/{view}").status_code == 200


def test_bytes_are_counted_whether_announced_or_not() -> None:
    image = encoded(drawn(256, 256), "png")
    for body in (image, iter([image])):
        with limited(limit_mb=len(image) / 1e6) as client:
            assert client.post("/enroll", content=body, headers={"content-type": "image/png"}).status_code == 201
            answer = client.post("/query", content=image, headers={"content-type": "image/png"})
            assert answer.status_code == 429
            assert "bytes a minute" in answer.json()["detail"]
