"""Traces: one span a request, one a stage, in the caller's trace; nothing is loaded while they are off."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from app.cli.logs import JsonLines, _WithContext
from app.http.tracing import make_provider
from schemas.errors import SetupError
from tests.http.fakes import FakeRecogniser, FakeRuntime
from tests.openapi import CheckedClient
from tests.sample_images import photo

JPEG = {"content-type": "image/jpeg"}
ROOT = Path(__file__).parents[2]
TRACE, PARENT = "0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331"


@pytest.fixture
def exporter() -> Any:
    """Keeps spans in memory."""
    pytest.importorskip("opentelemetry.sdk", reason="TRACES ARE NOT TESTED: the extra `otel` is not installed")
    from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

    return InMemorySpanExporter()


def traced(runtime: FakeRuntime, exporter: Any) -> CheckedClient:
    from opentelemetry.sdk.trace import TracerProvider
    from opentelemetry.sdk.trace.export import SimpleSpanProcessor

    provider = TracerProvider(shutdown_on_exit=False)
    provider.add_span_processor(SimpleSpanProcessor(exporter))
    return CheckedClient(runtime.app(provider))


def test_a_query_continues_the_callers_trace_and_shows_its_stages(runtime: FakeRuntime, exporter: Any) -> None:
    with traced(runtime, exporter) as client:
        client.post("/enroll?map=m", content=photo(), headers=JPEG)
        exporter.clear()
        parent = {"traceparent": f"00-{TRACE}-{PARENT}-01", "x-request-id": "r1"}
        assert client.post("/query?map=m&near=1,2,3", content=photo(), headers=JPEG | parent).status_code == 200
        spans = {span.name: span for span in exporter.get_finished_spans()}

    whole = spans.pop("POST /query")
    assert {f"{span.context.trace_id:032x}" for span in (whole, *spans.values())} == {TRACE}
    assert f"{whole.parent.span_id:016x}" == PARENT
    assert dict(whole.attributes) == {
        "http.request.method": "POST",
        "http.route": "/query",
        "http.response.status_code": 200,
        "revisit.request_id": "r1",
    }
    assert {"query decode", "query encode", "query search"} <= spans.keys()
    assert {span.parent.span_id for span in spans.values()} == {whole.context.span_id}
    assert "query total" not in spans


def test_a_failure_is_marked_and_its_log_line_has_the_trace(
    runtime: FakeRuntime, recogniser: FakeRecogniser, exporter: Any, caplog: pytest.LogCaptureFixture
) -> None:
    recogniser.fails["view"] = ZeroDivisionError("secret")
    caplog.handler.addFilter(_WithContext())
    with traced(runtime, exporter) as client:
        client.get("/livez")
        answer = client.get("/views/v", headers={"traceparent": f"00-{TRACE}-{PARENT}-01"})
    (span,) = exporter.get_finished_spans()
    assert answer.status_code == 500
    assert not span.status.is_ok
    assert "secret" not in span.to_json()
    lines = [json.loads(JsonLines().format(record)) for record in caplog.records]
    assert answer.json()["request_id"] in {line.get("request_id") for line in lines}


def test_nothing_of_opentelemetry_is_loaded_while_traces_are_off() -> None:
    told = "import app.http.application, sys; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", told], cwd=ROOT, capture_output=True, text=True, check=True
    )
    # FastAPI may load its interface, which sends nothing.
    assert [name for name in loaded.stdout.split() if name.startswith("opentelemetry.sdk")] == []
    assert [name for name in loaded.stdout.split() if name.startswith("opentelemetry.exporter")] == []
    assert "prometheus_client" in loaded.stdout.split()


def test_without_the_packages_a_start_says_how_to_get_them(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("opentelemetry.sdk.trace", "opentelemetry.exporter.otlp.proto.http.trace_exporter"):
        with monkeypatch.context() as patched:
            patched.setitem(sys.modules, name, None)
            with pytest.raises(
                SetupError, match="pip install opentelemetry-sdk opentelemetry-exporter-otlp-proto-http"
            ):
                make_provider()


@pytest.mark.parametrize(
    ("variables", "name"),
    [
        ({}, "revisit"),
        ({"OTEL_RESOURCE_ATTRIBUTES": "deployment.environment=prod,service.name=museum"}, "museum"),
        ({"OTEL_RESOURCE_ATTRIBUTES": "service.name=museum", "OTEL_SERVICE_NAME": "places"}, "places"),
    ],
)
def test_the_service_is_called_as_the_variables_say(
    variables: dict[str, str], name: str, exporter: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable, value in {"OTEL_TRACES_EXPORTER": "none", **variables}.items():
        monkeypatch.setenv(variable, value)
    assert make_provider().resource.attributes["service.name"] == name


def test_a_variable_that_cannot_be_used_is_told_at_the_start(exporter: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OTEL_BSP_MAX_EXPORT_BATCH_SIZE", "100000")
    with pytest.raises(SetupError, match=r"OTEL_.*: max_export_batch_size"):
        make_provider()
