"""Requests that the client sends, answers that it reads, and when it tries again."""

import json
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from revisit_client import ClientError, JobFailed, Revisit, RevisitProblem, Unreachable

from app.http.examples import CALIBRATION_REPORT
from tests import answers

Handler = Callable[[httpx.Request], httpx.Response]


class Clock:
    """Time that passes only by sleeping."""

    def __init__(self) -> None:
        self.now = 0.0
        self.naps: list[float] = []

    def sleep(self, seconds: float) -> None:
        self.naps.append(seconds)
        self.now += seconds

    def read(self) -> float:
        return self.now


def client(handler: Handler, clock: Clock | None = None, **options: Any) -> Revisit:
    clock = clock or Clock()
    return Revisit(
        "http://test", transport=httpx.MockTransport(handler), sleep=clock.sleep, clock=clock.read, **options
    )


def refused(code: str, status: int, **headers: str) -> httpx.Response:
    return httpx.Response(status, json=answers.problem(code, status), headers=headers)


def test_an_image_is_enrolled_with_its_attributes(tmp_path: Path) -> None:
    seen: list[httpx.Request] = []

    def handler(request: httpx.Request) -> httpx.Response:
        seen.append(request)
        return httpx.Response(201, json=answers.enrolled())

    path = tmp_path / "a.png"
    path.write_bytes(b"bytes of an image")
    when = datetime(2026, 3, 1, 12, tzinfo=UTC)
    with client(handler) as revisit:
        enrolled = revisit.enroll(path, map="campus", place="door", x=1, y=2.5, captured_at=when, metadata={"a": 1})

    assert enrolled.created
    assert enrolled.view.place == "square"
    body = seen[0].read().decode()
    for part in ("bytes of an image", "campus", "door", "2.5", "2026-03-01T12:00:00.000000Z", '{"a": 1}', "a.png"):
        assert part in body
    assert 'name="lat"' not in body


def test_a_busy_service_is_called_again_after_the_time_it_names_with_the_same_key() -> None:
    keys: list[str] = []
    clock = Clock()

    def handler(request: httpx.Request) -> httpx.Response:
        keys.append(request.headers["idempotency-key"])
        if len(keys) < 3:
            return refused("too-many-requests", 429, **{"retry-after": "3"})
        return httpx.Response(201, json=answers.enrolled())

    client(handler, clock).enroll(b"x")

    assert clock.naps == [3.0, 3.0]
    assert len(set(keys)) == 1


def test_two_enrolments_have_two_keys() -> None:
    keys: list[str] = []

    def handler(request: httpx.Request) -> httpx.Response:
        keys.append(request.headers["idempotency-key"])
        return httpx.Response(201, json=answers.enrolled())

    revisit = client(handler)
    revisit.enroll(b"x")
    revisit.enroll(b"x")

    assert keys[0] != keys[1]


def test_patience_ends() -> None:
    clock = Clock()
    revisit = client(lambda _: refused("unavailable", 503, **{"retry-after": "20"}), clock, patience=50)

    with pytest.raises(RevisitProblem) as caught:
        revisit.maps()

    assert clock.naps == [20.0, 20.0]
    assert (caught.value.code, caught.value.status, caught.value.retry_after_s) == ("unavailable", 503, 20.0)


def test_without_a_retry_after_the_pauses_grow() -> None:
    clock = Clock()

    with pytest.raises(RevisitProblem):
        client(lambda _: refused("unavailable", 503), clock, patience=2).maps()

    assert clock.naps == [0.25, 0.5, 1.0]


@pytest.mark.parametrize("status", [400, 404, 409, 413, 415, 422, 500, 507])
def test_other_refusals_are_not_repeated(status: int) -> None:
    clock = Clock()

    with pytest.raises(RevisitProblem):
        client(lambda _: refused("not-found", status), clock).maps()

    assert clock.naps == []


def test_a_refusal_lists_every_parameter() -> None:
    errors = [{"parameter": "x", "detail": "is missing"}, {"parameter": "top", "detail": "too large"}]

    with pytest.raises(RevisitProblem) as caught:
        client(lambda _: httpx.Response(422, json=answers.problem("invalid-parameter", 422, errors=errors))).query(b"x")

    assert [e.parameter for e in caught.value.errors] == ["x", "top"]
    assert str(caught.value).splitlines()[1:] == ["  x: is missing", "  top: too large"]
    assert str(caught.value).count("is missing") == 1


def test_a_refusal_of_one_parameter_is_said_once() -> None:
    problem = answers.problem("invalid-parameter", 422, errors=[{"parameter": "x", "detail": "is missing"}])
    with pytest.raises(RevisitProblem) as caught:
        client(lambda _: httpx.Response(422, json={**problem, "detail": "x: is missing"})).query(b"x")
    assert str(caught.value).endswith(": x: is missing")
    assert "\n" not in str(caught.value)


def test_a_page_of_a_proxy_is_a_problem_too() -> None:
    with pytest.raises(RevisitProblem, match="HTTP 502 Bad Gateway"):
        client(lambda _: httpx.Response(502, text="<html>upstream</html>")).maps()


@pytest.mark.parametrize("body", ["<html>sign in</html>", "[]"])
def test_a_page_of_a_proxy_is_no_openapi_document(body: str) -> None:
    with pytest.raises(ClientError, match="something that is not revisit's"):
        client(lambda _: httpx.Response(200, text=body)).openapi()


def test_without_a_service_the_error_says_how_to_start_one() -> None:
    def handler(request: httpx.Request) -> httpx.Response:
        raise httpx.ConnectError("[Errno 111] Connection refused")

    with pytest.raises(Unreachable, match=r"\./revisit serve"):
        client(handler).maps()


def test_filters_of_a_query_are_sent_as_documented() -> None:
    bodies: list[str] = []

    def handler(request: httpx.Request) -> httpx.Response:
        bodies.append(request.read().decode())
        return httpx.Response(200, json=answers.query_answer(answers.match()))

    answer = client(handler).query(
        b"x",
        top=3,
        near=(1.0, 2.0, 30.0),
        geographic=True,
        exclude_last=timedelta(seconds=30),
        exclude=["a", "b"],
        metadata={"floor": "2"},
        where={"place": {"$prefix": "a/"}, "captured_at": {"$gte": datetime(2026, 3, 1, 9, 30, tzinfo=UTC)}},
        explain=False,
    )

    assert answer.matches[0].view.place == "square"
    where = '{"place": {"$prefix": "a/"}, "captured_at": {"$gte": "2026-03-01T09:30:00.000000Z"}}'
    for part in ("1.0,2.0,30.0", "geo", "30s", "a,b", 'name="metadata.floor"', "false", where):
        assert part in bodies[0]


def test_views_are_fetched_page_by_page_as_needed() -> None:
    cursors: list[str | None] = []

    def handler(request: httpx.Request) -> httpx.Response:
        cursor = request.url.params.get("cursor")
        cursors.append(cursor)
        page = int(cursor or 0)
        views = [answers.view(f"v{page}{i}") for i in range(2)]
        return httpx.Response(200, json={"views": views, "next": str(page + 1) if page < 2 else None})

    revisit = client(handler)
    assert [v.id for v in revisit.views()] == ["v00", "v01", "v10", "v11", "v20", "v21"]
    assert cursors == [None, "1", "2"]
    cursors.clear()
    assert [v.id for v in revisit.views(limit=3)] == ["v00", "v01", "v10"]
    assert cursors == [None, "1"]


def polled(states: Iterator[str]) -> Handler:
    """A service that has no events: a proxy keeps them back, or it is an older one."""
    return lambda request: (
        httpx.Response(404, json=answers.problem("not-found"))
        if request.url.path.endswith("/events")
        else httpx.Response(200, json=answers.job(next(states)))
    )


def test_a_job_is_waited_for() -> None:
    clock = Clock()

    job = client(polled(iter(["waiting", "running", "done"])), clock).wait_for_job("j")

    assert job.state == "done"
    assert len(clock.naps) == 2


def sent_events(*states: str) -> httpx.Response:
    """Events of a job, with a sign of life between them."""
    parts = [f"event: job\ndata: {json.dumps(answers.job(state))}\nretry: 1000\n\n" for state in states]
    return httpx.Response(200, text=": keepalive\n\n".join(parts), headers={"content-type": "text/event-stream"})


def test_the_states_of_a_job_that_is_waited_for_are_sent_by_the_service() -> None:
    clock, followed, paths = Clock(), list[str](), list[str]()

    def handler(request: httpx.Request) -> httpx.Response:
        paths.append(request.url.path)
        if paths[-1] == "/jobs/j/events":
            return sent_events("waiting", "running", "done")
        return httpx.Response(200, json=answers.job("waiting"))

    job = client(handler, clock).wait_for_job("j", follow=lambda job: followed.append(job.state))

    assert (job.state, clock.naps, paths) == ("done", [], ["/jobs/j", "/jobs/j/events"])
    assert list(dict.fromkeys(followed)) == ["waiting", "running", "done"]


@pytest.mark.parametrize("broken", ["cut", "damaged", "no events", "not a job", "busy"])
def test_a_job_whose_events_do_not_come_through_is_polled(broken: str) -> None:
    clock, states = Clock(), iter(["running", "running", "done"])

    def handler(request: httpx.Request) -> httpx.Response:
        if not request.url.path.endswith("/events"):
            return httpx.Response(200, json=answers.job(next(states)))
        if broken == "cut":
            raise httpx.RemoteProtocolError("peer closed connection")
        if broken == "damaged":
            zipped = {"content-type": "text/event-stream", "content-encoding": "gzip"}
            return httpx.Response(200, stream=httpx.ByteStream(b"no gzip"), headers=zipped)
        if broken == "busy":
            return httpx.Response(429, json=answers.problem("too-many-requests", 429))
        if broken == "no events":
            return httpx.Response(200, json=answers.job("running"))
        return httpx.Response(200, text="data: {}\n\n", headers={"content-type": "text/event-stream"})

    assert client(handler, clock).wait_for_job("j").state == "done"
    assert len(clock.naps) == 2


def test_events_of_a_map_that_the_key_may_not_use_are_refused() -> None:
    def handler(request: httpx.Request) -> httpx.Response:
        if request.url.path.endswith("/events"):
            return httpx.Response(403, json=answers.problem("forbidden", 403))
        return httpx.Response(200, json=answers.job("running"))

    with pytest.raises(RevisitProblem):
        client(handler, Clock()).wait_for_job("j")


def test_a_job_that_failed_says_why() -> None:
    failed = answers.job("failed", failure={"code": "nothing-static", "detail": "all moves"})

    with pytest.raises(JobFailed, match="all moves"):
        client(lambda _: httpx.Response(200, json=failed)).wait_for_job("j")


def test_a_job_is_not_waited_for_forever() -> None:
    with pytest.raises(TimeoutError, match="still running"):
        client(lambda _: httpx.Response(200, json=answers.job("running"))).wait_for_job("j", timeout=3)


def test_readiness_is_an_answer_also_when_it_is_no() -> None:
    unready = {"ready": False, "checks": {"encoder": "loading"}}

    assert client(lambda _: httpx.Response(503, json=unready)).readyz().checks == {"encoder": "loading"}


def test_a_newer_service_may_add_fields() -> None:
    body = answers.enrolled() | {"news": 1}
    body["view"]["more"] = {"a": 1}

    assert client(lambda _: httpx.Response(201, json=body)).enroll(b"x").created


def test_an_older_service_may_lack_fields_and_is_not_taken_for_something_else() -> None:
    body = answers.enrolled()
    del body["created"]
    with pytest.raises(ClientError, match="or of a version before this client's"):
        client(lambda _: httpx.Response(201, json=body)).enroll(b"x")


def test_something_else_at_the_address_is_named() -> None:
    with pytest.raises(ClientError, match="not revisit's"):
        client(lambda _: httpx.Response(200, text="hello")).maps()


def test_the_address_comes_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("REVISIT_URL", "http://robot:9000/")
    with Revisit() as revisit:
        assert revisit.url == "http://robot:9000"
    with Revisit("http://bob:secret@robot:9000/") as revisit:
        assert revisit.url == "http://***@robot:9000"


def test_a_map_is_calibrated_and_returns_to_the_shipped_calibration() -> None:
    seen: list[httpx.Request] = []

    def handler(request: httpx.Request) -> httpx.Response:
        seen.append(request)
        return httpx.Response(200, json=CALIBRATION_REPORT if request.method == "POST" else answers.map_facts())

    label = {"features": {"gap": 1.0, "level": 0.0}, "right": True}
    with client(handler) as revisit:
        report = revisit.calibrate("campus", observed=[label], queries=[{"view": "v", "place": None}], dry_run=True)
        facts = revisit.forget_calibration("campus")

    assert (report.transfers, report.own.precision.count, facts.name) == (True, 105, "default")
    assert json.loads(seen[0].read()) == {
        "observed": [label],
        "queries": [{"view": "v", "place": None}],
        "dry_run": True,
    }
    assert [(r.method, r.url.path) for r in seen] == [(m, "/maps/campus/calibration") for m in ("POST", "DELETE")]
