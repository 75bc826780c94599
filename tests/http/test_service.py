"""Health, metrics, documentation, and properties of all answers."""

import asyncio
import json
import logging
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from app.http.examples import CALIBRATION_REPORT, ENROLLED, PATCH, POST_CALIBRATION, PROBLEM_DETAILS, QUERY_ANSWER, VIEW
from app.http.problems import KINDS, URN, shape_of
from schemas import errors, wire
from schemas.requests import PostCalibration
from tests.http.fakes import FakeRecogniser, FakeRuntime
from tests.openapi import CheckedClient
from tests.sample_images import photo
from tests.waiting import until

JPEG = {"content-type": "image/jpeg"}
ROOT = Path(__file__).parents[2]


def test_the_runtime_is_started_and_stopped_with_the_application(runtime: FakeRuntime) -> None:
    with CheckedClient(runtime.app()):
        assert runtime.recogniser.events == ["start"]
    assert runtime.recogniser.events == ["start", "stop"]


@pytest.mark.parametrize("path", ["/livez", "/readyz", "/metrics", "/version", "/maps", "/views", "/places"])
def test_no_dependency_of_a_route_waits_for_a_thread(
    client: CheckedClient, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    """FastAPI runs dependencies that are no coroutines in a thread: /readyz would wait while all threads are busy."""

    def busy(*_: object) -> None:
        raise AssertionError("every thread works")

    monkeypatch.setattr("fastapi.dependencies.utils.run_in_threadpool", busy)
    assert client.get(path).status_code == 200
    assert client.post("/enroll", content=photo(), headers=JPEG).status_code == 201


# request ids and logs


@pytest.mark.parametrize("given", ["abc", "A.b_c-9", "x" * 128])
def test_a_sane_request_id_comes_back(client: CheckedClient, given: str) -> None:
    assert client.get("/livez", headers={"x-request-id": given}).headers["x-request-id"] == given


@pytest.mark.parametrize("given", ["", "a b", "x" * 129, "a\tb", "<script>", "ü".encode()])
def test_any_other_request_id_is_replaced(client: CheckedClient, given: str | bytes) -> None:
    answer = client.get(
        "/views/none", headers=[(b"x-request-id", given if isinstance(given, bytes) else given.encode())]
    )
    assert re.fullmatch("[0-9a-f]{32}", answer.headers["x-request-id"])
    assert answer.json()["request_id"] == answer.headers["x-request-id"]


def test_every_request_is_logged_without_its_parameters(
    client: CheckedClient, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "revisit.access")
    client.post("/enroll?lat=48.137&lon=11.575", content=photo(), headers=JPEG | {"x-request-id": "r1"})
    (record,) = [r for r in caplog.records if r.name == "revisit.access"]
    fields = vars(record)
    assert (fields["method"], fields["route"], fields["status"]) == ("POST", "/enroll", 201)
    assert fields["request_id"] == "r1"
    assert fields["ms"] > 0
    assert "48.137" not in str(fields)


# internal errors


def test_an_internal_error_gives_the_client_its_id_and_the_log_its_traceback(
    client: CheckedClient, recogniser: FakeRecogniser, caplog: pytest.LogCaptureFixture
) -> None:
    recogniser.fails["view"] = ZeroDivisionError("the secret path")
    answer = client.get("/views/v", headers={"x-request-id": "r2"})
    assert (answer.status_code, answer.json()["type"]) == (500, URN + "internal")
    assert "secret" not in answer.text
    (record,) = [r for r in caplog.records if r.name == "revisit.http"]
    assert record.exc_info is not None
    assert vars(record)["request_id"] == "r2"


def test_errors_that_concern_no_client_are_internal(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    recogniser.fails["view"] = errors.LeaseLost("too late")
    answer = client.get("/views/v")
    assert (answer.status_code, answer.json()["type"]) == (500, URN + "internal")
    assert "too late" not in answer.text


# starting and draining


@pytest.mark.parametrize(("attribute", "value"), [("started", False), ("draining", True)])
def test_while_the_service_starts_or_drains_it_says_when_to_try_again(
    client: CheckedClient, recogniser: FakeRecogniser, attribute: str, value: bool
) -> None:
    setattr(recogniser, attribute, value)
    for answer in (client.get("/views"), client.post("/query", content=photo(), headers=JPEG), client.get("/version")):
        assert (answer.status_code, answer.json()["type"]) == (503, URN + "unavailable")
        assert int(answer.headers["retry-after"]) > 0
    assert client.get("/livez").status_code == 200
    assert client.get("/metrics").status_code == 200
    ready = client.get("/readyz")
    assert (ready.status_code, ready.json()["ready"]) == (503, False)
    assert int(ready.headers["retry-after"]) > 0


def test_readiness_answers_in_time_even_if_the_runtime_does_not(
    client: CheckedClient, recogniser: FakeRecogniser
) -> None:
    ready = client.get("/readyz").json()
    assert ready == {"ready": True, "checks": {"store": "ok", "encoder": "ok"}, "maps": {}, "age_s": 0.0}
    recogniser.hold = asyncio.Event()

    def took_s() -> float:
        begin = time.perf_counter()
        assert client.get("/readyz").status_code == 503
        return time.perf_counter() - begin

    until(lambda: took_s() < 0.5)  # other work may hold up any single answer


# metrics


def test_metrics_count_requests_by_route_and_stages(client: CheckedClient) -> None:
    client.post("/enroll?map=m", content=photo(), headers=JPEG)
    client.get("/views/nothing-of-the-kind")
    client.get("/nowhere")
    text = client.get("/metrics").text
    assert 'revisit_http_requests_total{method="POST",route="/enroll",status="2xx"} 1.0' in text
    assert 'revisit_http_requests_total{method="GET",route="/views/{view_id}",status="4xx"} 1.0' in text
    assert 'route="unmatched",status="4xx"' in text
    assert 'revisit_stage_duration_seconds_count{operation="enroll",stage="decode"} 1.0' in text
    assert 'revisit_views{map="m",state="ready"} 1.0' in text
    assert 'revisit_jobs{kind="describe",state="waiting"} 3.0' in text
    assert "nothing-of-the-kind" not in text


def test_metrics_are_there_even_when_the_maps_are_not(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    recogniser.fails["maps"] = errors.NotFound("map", "m")
    assert client.get("/metrics").status_code == 200


# pages


def test_the_docs_load_nothing_from_elsewhere_and_run_no_scripts(client: CheckedClient) -> None:
    answer = client.get("/docs")
    assert answer.status_code == 200
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert not re.search(r"<script|<link|src=|@import|url\(", answer.text)
    assert not re.search(r'href=["\'](?!/)', answer.text)


def test_the_docs_name_every_route_and_parameter(client: CheckedClient) -> None:
    page = client.get("/docs").text
    document = client.get("/openapi.json").json()
    for path, methods in document["paths"].items():
        assert f"<code>{path}</code>" in page
        for operation in methods.values():
            for parameter in operation.get("parameters", []):
                assert f"<code>{parameter['name']}</code>" in page


def test_the_docs_say_what_each_route_does_and_lead_to_the_shapes_of_its_answers(client: CheckedClient) -> None:
    page = client.get("/docs").text

    [query] = re.findall(r"<summary>.*?<code>/query</code>(.*?)</summary>(.*?)</details>", page, re.DOTALL)
    assert "Which views of a map, or of several, show the place of this image?" in query[0]
    assert "With <code>Accept: application/geopose+json</code> the answer is the pose of these views" in query[1]
    assert "<a href='/docs#QueryAnswer'>QueryAnswer</a>" in query[1]
    shapes = set(re.findall(r"<details id='(\w+)'>", page))
    assert shapes >= set(re.findall(r"'/docs#(\w+)'", page))


# the OpenAPI document


def test_examples_fit_the_models() -> None:
    wire.View.model_validate(VIEW)
    wire.Enrolled.model_validate(ENROLLED)
    assert json.loads(wire.QueryAnswer.model_validate(QUERY_ANSWER).model_dump_json()) == QUERY_ANSWER
    assert json.loads(wire.CalibrationReport.model_validate(CALIBRATION_REPORT).model_dump_json()) == CALIBRATION_REPORT
    PostCalibration.model_validate(POST_CALIBRATION, strict=True)
    assert set(PATCH) <= set(wire.View.model_fields)
    assert PROBLEM_DETAILS.keys() == KINDS.keys()


def test_the_document_refers_to_nothing_that_is_missing(client: CheckedClient) -> None:
    document = client.get("/openapi.json").json()
    names = set(document["components"]["schemas"])
    assert set(re.findall(r"#/components/schemas/(\w+)", json.dumps(document))) <= names
    assert "HTTPValidationError" not in names


def test_the_document_is_one_of_the_version_that_it_names(client: CheckedClient) -> None:
    """Validators refuse a whole document for one field that this version of OpenAPI does not have."""
    document = client.get("/openapi.json").json()
    known = {"schema", "example", "examples", "encoding"}
    sent = [operation for methods in document["paths"].values() for operation in methods.values()]
    bodies = [body for one in sent for body in (one.get("requestBody", {}), *one["responses"].values())]

    strange = {field for body in bodies for kind in body.get("content", {}).values() for field in kind.keys() - known}

    assert document["openapi"] == "3.1.0"
    assert {field for field in strange if not field.startswith("x-")} == set()


def test_every_route_documents_its_bodies_and_refusals(client: CheckedClient) -> None:
    paths = client.get("/openapi.json").json()["paths"]
    for path, methods in paths.items():
        for method, operation in methods.items():
            assert operation["description"], path
            assert "500" in operation["responses"], path
            for parameter in operation.get("parameters", []):
                assert parameter["description"], f"{method} {path} {parameter['name']}"
                assert "anyOf" not in parameter["schema"], "text on the wire is never null"
            assert {"post": True, "put": True, "patch": True}.get(method, False) <= (
                "requestBody" in operation or path.endswith(("/vocabulary", "/snapshots", "/switch"))
            )
    for path in ("/enroll", "/query"):
        content = paths[path]["post"]["requestBody"]["content"]
        assert {"multipart/form-data", "image/jpeg", "image/png"} <= content.keys()
        in_url = {p["name"] for p in paths[path]["post"]["parameters"] if p["in"] == "query"} - {"metadata.KEY"}
        assert in_url == content["multipart/form-data"]["schema"]["properties"].keys() - {"image"}


# one shape of error


def _without_body(client: CheckedClient, method: str, path: str) -> Any:
    return client.request(method, re.sub(r"\{\w+\}", ".no such.", path))


def test_every_route_answers_errors_in_the_same_shape(client: CheckedClient) -> None:
    """Unknown paths, unknown methods, and an unknown parameter on every route."""
    answers = [client.get("/nowhere"), client.get("/views//"), client.put("/query"), client.post("/livez")]
    for path, methods in client.get("/openapi.json").json()["paths"].items():
        answers += [client.request(method, path.replace("{map}", "m") + "?no=such") for method in methods]
    for answer in answers:
        assert answer.status_code in (400, 404, 405, 422), answer.request.url
        assert answer.headers["content-type"] == "application/problem+json"
        body = shape_of(answer.request.url.path).model_validate(answer.json())
        kind = KINDS[body.type.removeprefix(URN)]
        assert (body.status, body.title) == (answer.status_code, kind.title)
        assert body.request_id == answer.headers["x-request-id"]
    assert answers[2].headers["allow"] == "POST"


def test_every_route_refuses_repeated_parameters(client: CheckedClient) -> None:
    for path, methods in client.get("/openapi.json").json()["paths"].items():
        for method in methods:
            url = path.replace("{map}", "m") + "?no=such&no=such"
            answer = client.request(method, url, content=photo() if path in ("/enroll", "/query") else None)
            told = {f"{e['parameter']} {e['detail']}".partition(";")[0] for e in answer.json()["errors"]}
            told -= {one for one in told if one.endswith(" is required")}
            assert told == {"no was given 2 times", "no is unknown"}, f"{method} {path}"


def test_the_documentation_of_errors_is_the_table() -> None:
    text = (ROOT / "docs" / "errors.md").read_text()
    rows = re.findall(r"^\| `([a-z-]+)` \| (\d+) \| (.+) \| (.+) \|$", text, re.MULTILINE)
    assert {code: (int(status), title, remedy) for code, status, title, remedy in rows} == {
        code: (kind.status, kind.title, kind.remedy) for code, kind in KINDS.items()
    }


def _codes_of(error: type[errors.RevisitError]) -> set[str]:
    return {error.code} | {code for kind in error.__subclasses__() for code in _codes_of(kind)}


def test_every_error_code_is_in_the_table() -> None:
    ours = {"internal", errors.LeaseLost.code, errors.DescriptorMismatch.code, errors.SetupError.code}
    ours.add(errors.CallerGone.code)  # nobody is left to be told
    ours.add("unexpected-layout")  # of a data set on disk, reported by the command line
    assert _codes_of(errors.RevisitError) - ours <= KINDS.keys()


# repeated calls


def enroll(client: CheckedClient, key: str | bytes, seed: int = 0, **parameters: str) -> Any:
    return client.post(
        "/enroll",
        params=parameters,
        content=photo(seed),
        headers=JPEG | {"idempotency-key": key},
    )


def test_a_repeated_call_is_answered_the_same_and_done_once(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    first = enroll(client, "k1", place="hall")
    again = enroll(client, "k1", place="hall")
    assert again.status_code == first.status_code == 201
    assert again.content == first.content
    assert again.headers["location"] == first.headers["location"]
    assert again.headers["idempotent-replayed"] == "true"
    assert "idempotent-replayed" not in first.headers
    assert recogniser.enrolments == 1


@pytest.mark.parametrize("change", [{"seed": 1}, {"place": "cellar"}, {"wait": "true"}])
def test_a_key_with_another_request_is_refused(client: CheckedClient, change: dict[str, Any]) -> None:
    enroll(client, "k1", place="hall")
    answer = enroll(client, "k1", **{"place": "hall", **change})
    assert (answer.status_code, answer.json()["type"]) == (422, URN + "idempotency-key-reused")


def test_a_key_whose_first_call_still_runs_conflicts(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    enroll(client, "k1")
    recogniser.calls["k1"] = (recogniser.calls["k1"][0], None)
    assert enroll(client, "k1").status_code == 409


def test_a_refusal_is_remembered_and_a_failure_is_not(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    makes: Callable[[], Exception]
    for makes, status in (
        (lambda: errors.Busy("full", 3), 429),
        (lambda: errors.DiskFull("full"), 507),
        (lambda: RuntimeError("oops"), 500),
    ):
        recogniser.fails["enroll"] = makes()
        assert enroll(client, "k1").status_code == status
        assert not recogniser.calls
    recogniser.fails["enroll"] = errors.NothingStatic("only cars")
    assert enroll(client, "k1").status_code == 422
    recogniser.fails.clear()
    assert enroll(client, "k1").json()["type"] == URN + "nothing-static"


def test_an_answer_that_cannot_be_remembered_is_still_given(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    recogniser.fails["end_call"] = errors.DiskFull("full")
    assert enroll(client, "k1").status_code == 201


@pytest.mark.parametrize("key", ["", "two words", "x" * 256, "ü".encode()])
def test_a_malformed_key_is_refused(client: CheckedClient, key: str | bytes) -> None:
    answer = enroll(client, key)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["parameter"] == "Idempotency-Key"
