"""Who may call which route: every route of the application, with every kind of key."""

import asyncio
import json
import logging
import re
import statistics
import time
from collections.abc import Iterator
from datetime import datetime
from typing import Any

import httpx
import pytest
from fastapi.testclient import TestClient

from app.http.keys import FAILURES, KeyGate
from app.http.rate_limits import RateLimit
from app.http.scopes import OPEN_PATHS, ROUTES
from schemas import wire
from schemas.keys import SCOPES, Scope
from schemas.settings import Settings
from tests.http.document import document
from tests.http.fakes import FakeRuntime
from tests.keys_in_memory import KeyMaker
from tests.openapi import UNDOCUMENTED, CheckedClient
from tests.sample_images import drawn, encoded
from tests.waiting import until
from worker.service.keys import FRESH_S, checksum, new_key

JPEG = encoded(drawn(64, 64), "jpeg")
IMAGE = {"content-type": "image/jpeg"}

DOCUMENT = document()
ALL_ROUTES = sorted(
    {(method.upper(), path) for path, methods in DOCUMENT["paths"].items() for method in methods}
    | {("GET", path) for path in UNDOCUMENTED}
)
OF_ONE_MAP = ("/enroll", "/query", "/localize/geopose", "/metrics", "/restore")
CANCELLING = [
    *((kind, "read", 403) for kind in ("describe", "import", "recipe")),
    *((kind, "write", 409) for kind in ("describe", "import")),
    *((kind, "write", 403) for kind in ("recipe", "vocabulary", "snapshot")),
    *((kind, "admin", 409) for kind in ("describe", "import", "recipe", "vocabulary", "snapshot")),
]
LOCKED = [(method, path) for method, path in ALL_ROUTES if path not in OPEN_PATHS]


class Locked:
    """An application with one view in the map ``belfry``, and keys."""

    def __init__(self) -> None:
        self.keys = KeyMaker()
        self.runtime = FakeRuntime(keys=self.keys.service)
        self.client = CheckedClient(self.runtime.app())
        answer = self.client.post("/enroll?map=belfry", content=JPEG, headers=IMAGE)
        self.view: str = answer.json()["view"]["id"]
        self.admin = self.keys.make("operator", "admin")
        self.bearer: dict[Scope, str] = {scope: self.keys.make(f"{scope}-key", scope) for scope in SCOPES}

    def call(self, method: str, path: str, key: str | None) -> httpx.Response:
        """A call that would be answered without keys: the map is ``belfry`` wherever one can be named."""
        ids = {
            "view_id": self.view,
            "job_id": "j1",
            "query_id": "q1",
            "place_id": "u1",
            "snapshot_id": "s1",
            "proposal_id": "p1",
        }
        path = path.format(map="belfry", subject="hall/lift", **ids)
        options: dict[str, Any] = {"headers": {} if key is None else {"authorization": f"Bearer {key}"}}
        if path in ("/enroll", "/query"):
            path += "?map=belfry"
            options["content"] = JPEG
            options["headers"] |= IMAGE
        if path == "/restore":
            options["content"] = b"snapshot"
        if (method, path) == ("DELETE", "/views"):
            path += "?map=belfry&all=true"
        if method in ("PUT", "PATCH") or path.endswith(("/recipe", "/calibration", "/unknown/u1", "/proposals/p1")):
            options |= {"json": {}} if method != "DELETE" else {}
        response: httpx.Response = self.client.request(method, path, **options)
        return response


@pytest.fixture
def locked() -> Iterator[Locked]:
    made = Locked()
    with made.client:
        yield made


def code(response: httpx.Response) -> str:
    return str(response.json()["type"]).rpartition(":")[2]


def test_every_route_is_classified_and_no_other() -> None:
    assert set(ROUTES) | {("GET", path) for path in OPEN_PATHS} == set(ALL_ROUTES)


@pytest.mark.parametrize("kind", ["none", "wrong", "malformed", "expired", "revoked"])
@pytest.mark.parametrize(("method", "path"), LOCKED)
def test_a_route_is_closed_to_whoever_has_no_key_in_force(locked: Locked, method: str, path: str, kind: str) -> None:
    keys = {"none": None, "wrong": new_key()[1], "malformed": "letmein"}
    keys |= {"expired": locked.keys.expired(), "revoked": locked.keys.revoked()}

    response = locked.call(method, path, keys[kind])

    assert response.status_code == 401
    assert code(response) == "unauthorized"
    assert response.headers["www-authenticate"].startswith("Bearer")


@pytest.mark.parametrize("scope", SCOPES)
@pytest.mark.parametrize(("method", "path"), LOCKED)
def test_a_route_is_open_to_its_scope_and_those_above(locked: Locked, method: str, path: str, scope: Scope) -> None:
    response = locked.call(method, path, locked.bearer[scope])

    if SCOPES.index(scope) >= SCOPES.index(ROUTES[method, path]):
        assert response.status_code not in (401, 403)
    else:
        assert (response.status_code, code(response)) == (403, "forbidden")


@pytest.mark.parametrize(("kind", "scope", "status"), CANCELLING)
def test_a_job_is_cancelled_by_the_scope_that_may_begin_it(
    locked: Locked, kind: str, scope: Scope, status: int
) -> None:
    locked.runtime.recogniser.job_kind = kind

    # The job of the fake is running already, which is a conflict.
    assert locked.call("DELETE", "/jobs/{job_id}", locked.bearer[scope]).status_code == status


@pytest.mark.parametrize(("method", "path"), LOCKED)
def test_a_key_for_another_map_sees_nothing_of_this_one(locked: Locked, method: str, path: str) -> None:
    response = locked.call(method, path, locked.keys.make("elsewhere", "admin", "elsewhere"))

    assert "belfry" not in response.text or code(response) == "forbidden"
    if "{map}" in path or path in OF_ONE_MAP or (method, path) == ("DELETE", "/views"):
        assert (response.status_code, code(response)) == (403, "forbidden")
    elif any(name in path for name in ("{view_id}", "{job_id}", "{query_id}", "{snapshot_id}")):
        assert (response.status_code, code(response)) == (404, "not-found")
    else:
        assert response.status_code == 200
    assert locked.view in locked.runtime.recogniser.kept


def test_an_address_of_compreface_without_a_map_needs_a_key_for_the_default_one(locked: Locked) -> None:
    path = "/compat/compreface/api/v1/recognition/subjects"
    told = {
        name: TestClient(locked.client.app).get(path, headers={"x-api-key": locked.keys.make(name, "read", name)})
        for name in ("default", "belfry")
    }
    assert (told["default"].status_code, set(told["default"].json())) == (200, {"subjects"})
    assert (told["belfry"].status_code, code(told["belfry"])) == (403, "forbidden")
    assert told["belfry"].json()["message"] == told["belfry"].json()["detail"]


@pytest.mark.parametrize("path", ["/views", "/places", "/jobs"])
def test_a_list_of_a_map_that_the_key_may_not_use_is_refused_and_its_own_given(locked: Locked, path: str) -> None:
    key = locked.keys.make("visitor", "read", "belfry", "default")
    bearer = {"authorization": f"Bearer {key}"}

    # Whether or not there is such a map.
    assert locked.client.get(f"{path}?map=other", headers=bearer).status_code == 403
    assert locked.client.get(f"{path}?map=belfry", headers=bearer).status_code == 200
    (listed,) = [rows for rows in locked.client.get(path, headers=bearer).json().values() if isinstance(rows, list)]
    assert len(listed) == 1


@pytest.mark.parametrize("path", ["/enroll", "/query"])
def test_a_map_inside_a_multipart_body_is_checked_too(locked: Locked, path: str) -> None:
    key = locked.keys.make("visitor", "write", "elsewhere")
    sent = {"files": {"image": ("a.jpg", JPEG)}, "headers": {"x-api-key": key}}

    assert locked.client.post(path, data={"map": "belfry"}, **sent).status_code == 403
    assert locked.client.post(path, data={"map": "elsewhere"}, **sent).status_code in (201, 404)
    assert [kept.map for kept in locked.runtime.recogniser.kept.values()].count("belfry") == 1


def test_an_id_of_another_map_is_answered_like_one_that_does_not_exist(locked: Locked) -> None:
    bearer = {"authorization": f"Bearer {locked.keys.make('visitor', 'admin', 'elsewhere')}"}
    there = locked.client.get(f"/views/{locked.view}", headers=bearer).json()
    nowhere = locked.client.get("/views/0195f2a4", headers=bearer).json()

    assert there["detail"].replace(locked.view, "ID") == nowhere["detail"].replace("0195f2a4", "ID")


def test_either_header_carries_the_key_but_not_two_keys_that_differ(locked: Locked) -> None:
    key, other = locked.bearer["read"], locked.admin

    def status(*headers: tuple[str, str]) -> int:
        return int(locked.client.get("/maps", headers=list(headers)).status_code)

    assert status(("X-Api-Key", key)) == 200
    assert status(("authorization", f"bearer  {key}")) == 200
    assert status(("authorization", f"Bearer {key}"), ("x-api-key", key)) == 200
    assert status(("authorization", f"Bearer {key}"), ("x-api-key", other)) == 401
    assert status(("x-api-key", key), ("x-api-key", other)) == 401
    # A proxy's own password is none of the service's business.
    assert status(("authorization", "Basic cmV2aXNpdDpyZXZpc2l0"), ("x-api-key", key)) == 200
    assert status(("authorization", f"Basic {key}")) == 401


def test_without_keys_nobody_needs_one_and_with_the_first_everybody_does_at_once() -> None:
    keys = KeyMaker()
    with CheckedClient(FakeRuntime(keys=keys.service).app()) as client:
        assert client.get("/maps", headers={"x-api-key": "whatever"}).status_code == 200
        keys.make("first", "admin")
        assert client.get("/maps").status_code == 401


def test_a_key_that_another_process_makes_or_revokes_is_noticed_within_a_second(locked: Locked) -> None:
    key = locked.bearer["read"]
    assert locked.call("GET", "/maps", key).status_code == 200
    locked.keys.store.revoke("read-key", locked.keys.store.all()[0].created_at)  # behind the service's back
    assert FRESH_S < 1
    locked.keys.seconds += FRESH_S
    assert locked.call("GET", "/maps", key).status_code == 401


def test_revoking_the_last_key_opens_nothing() -> None:
    keys = KeyMaker()
    keys.revoked()
    with CheckedClient(FakeRuntime(keys=keys.service).app()) as client:
        assert client.get("/maps").status_code == 401


def test_keys_that_cannot_be_read_let_nobody_in(locked: Locked) -> None:
    locked.keys.store.fails = OSError("disk")
    locked.keys.seconds += FRESH_S

    assert locked.call("GET", "/maps", locked.admin).status_code == 503
    assert locked.call("GET", "/livez", None).status_code == 200


def test_probes_need_no_key_and_name_no_map_to_whoever_has_none(
    locked: Locked, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def readiness() -> wire.Readiness:
        checks = {"database": "ok", "map belfry": "lost its vocabulary"}
        return wire.Readiness(
            ready=True,
            checks=checks,
            maps={"belfry": wire.MapReadiness(state="lost its vocabulary", revision=3, indexed=None)},
        )

    monkeypatch.setattr(locked.runtime.recogniser, "readiness", readiness)
    for path in OPEN_PATHS:
        assert locked.call("GET", path, None).status_code == 200
        assert locked.call("GET", path, "wrong").status_code == 200

    assert "belfry" not in locked.call("GET", "/readyz", None).text
    assert "1 cannot be served" in locked.call("GET", "/readyz", None).text
    assert "belfry" not in locked.call("GET", "/readyz", locked.keys.make("other", "admin", "other")).text
    told = locked.call("GET", "/readyz", locked.bearer["read"]).json()
    assert "map belfry" in told["checks"]
    assert "belfry" in told["maps"]


def test_a_body_is_not_read_before_the_key_is_checked(locked: Locked) -> None:
    """25 MB from nobody cost nothing."""
    sent: list[dict[str, Any]] = []

    async def receive() -> dict[str, Any]:
        raise AssertionError("the body was asked for")

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {
        "type": "http", "http_version": "1.1", "method": "POST", "path": "/enroll", "query_string": b"",
        "root_path": "",
        "headers": [(b"content-type", b"image/jpeg")], "client": ("198.51.100.7", 1), "app": None,
    }  # fmt: skip

    async def call() -> None:
        await locked.client.app(scope, receive, send)

    asyncio.run(call())

    assert sent[0]["status"] == 401


def test_idempotency_keys_of_two_callers_do_not_meet(locked: Locked) -> None:
    def enroll(key: str, seed: int) -> httpx.Response:
        headers = {**IMAGE, "authorization": f"Bearer {key}", "idempotency-key": "same"}
        image = encoded(drawn(64, 64, seed), "jpeg")
        response: httpx.Response = locked.client.post("/enroll?map=belfry", content=image, headers=headers)
        return response

    assert enroll(locked.bearer["write"], 1).status_code == 201
    assert enroll(locked.admin, 2).status_code == 201
    assert enroll(locked.admin, 2).headers["idempotent-replayed"] == "true"


def test_guessing_is_slowed_down_and_locks_out_nobody_with_a_key(locked: Locked) -> None:
    statuses = [locked.call("GET", "/maps", "guess").status_code for _ in range(FAILURES + 5)]

    assert statuses == [401] * FAILURES + [429] * 5
    assert int(locked.call("GET", "/maps", None).headers["retry-after"]) >= 1
    assert locked.call("GET", "/maps", locked.admin).status_code == 200


def test_a_key_is_in_no_answer_and_in_no_log(locked: Locked, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    wrong, expired = new_key()[1], locked.keys.expired()
    locked.runtime.recogniser.fails["maps"] = RuntimeError("broken")
    answers = [locked.call("GET", "/maps", key).text for key in (locked.admin, locked.bearer["write"], wrong, expired)]
    answers.append(locked.call("DELETE", "/maps/{map}", locked.bearer["read"]).text)
    logged = [json.dumps(vars(record), default=str) + str(record.exc_text) for record in caplog.records]

    assert len(answers) == 5
    assert logged
    for key in (locked.admin, *locked.bearer.values(), wrong, expired):
        secret = key.rpartition("_")[2]
        assert not [text for text in answers + logged if secret in text]
        assert secret not in repr(locked.keys.store.kept)
    assert any('"key": "operator"' in text for text in logged)


def test_the_use_of_a_key_is_noted_to_the_hour(locked: Locked) -> None:
    def noted() -> datetime | None:
        return next(one.last_used_at for one in locked.keys.store.all() if one.name == "operator")

    locked.call("GET", "/maps", locked.admin)
    hour = until(noted)
    assert (hour.minute, hour.second) == (0, 0)


def test_a_scanner_for_secrets_can_tell_a_key(locked: Locked) -> None:
    for _ in range(50):
        key_id, key = new_key()
        assert re.fullmatch(rf"rv_{key_id}_[0-9A-Za-z]{{43}}[0-9A-Za-z]{{6}}", key)
        assert checksum(key[:-6]) == key[-6:]


def test_the_document_says_which_scope_a_route_needs() -> None:
    for (method, path), scope in ROUTES.items():
        if path not in UNDOCUMENTED:
            assert {"bearer": [scope]} in DOCUMENT["paths"][path][method.lower()]["security"]
    assert DOCUMENT["paths"]["/readyz"]["get"]["security"] == []


def test_a_key_costs_less_than_a_millisecond() -> None:
    """Of a ring with 1,000 keys; the median, since other work shares the machine."""
    keys = KeyMaker()
    key = [keys.make(f"robot-{number}", "read") for number in range(1000)][500]
    reached: list[Any] = []

    async def nothing(scope: Any, receive: Any, send: Any) -> None:
        reached.append(scope["state"]["access"].key)

    async def call() -> list[float]:
        limits = RateLimit(nothing, Settings(limit_requests=10_000, limit_all_requests=10_000))
        with_keys, spans = KeyGate(limits, keys.service), []
        for _ in range(500):
            keys.seconds += 0.01  # so that the keys are read anew for every fiftieth call
            begin = time.perf_counter()
            headers = [(b"authorization", f"Bearer {key}".encode())]
            scope: dict[str, Any] = {"type": "http", "method": "GET", "path": "/jobs/j1", "headers": headers}
            scope |= {"client": ("192.0.2.1", 1), "state": {}}
            await with_keys(scope, no_body, dropped)
            spans.append(time.perf_counter() - begin)
        return spans

    spans = asyncio.run(call())
    assert reached == ["robot-500"] * 500
    assert statistics.median(spans) < 0.001


async def no_body() -> Any:
    raise AssertionError("the body was asked for")


async def dropped(message: Any) -> None: ...


def test_probes_do_not_count_as_guessing(locked: Locked) -> None:
    for _ in range(FAILURES + 1):
        assert locked.call("GET", "/readyz", None).status_code == 200
    assert locked.call("GET", "/maps", None).status_code == 401


def test_a_view_of_another_map_is_not_compared_with_one_of_its_own(locked: Locked) -> None:
    own = locked.client.post(
        "/enroll?map=crypt", content=JPEG, headers=IMAGE | {"authorization": f"Bearer {locked.admin}"}
    ).json()["view"]["id"]
    headers = {"authorization": f"Bearer {locked.keys.make('sexton', 'read', 'crypt')}"}

    for drawing in ("", ".png"):
        path = f"/views/{own}/changes{drawing}?since="
        refused = locked.client.get(path + locked.view, headers=headers)
        unknown = locked.client.get(path + "unknown", headers=headers)
        assert (refused.status_code, unknown.status_code) == (404, 404)
        assert refused.json()["detail"].replace(locked.view, "unknown") == unknown.json()["detail"]
        assert locked.client.get(path + own, headers=headers).status_code == 200
