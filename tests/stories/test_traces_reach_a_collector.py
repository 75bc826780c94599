"""A service sends its traces to a collector: OTLP over HTTP, as the standard variables say."""

import socket
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from tests.otlp import collector
from tests.sample_images import photo
from tests.stories.running import RunningService

pytestmark = pytest.mark.one_database("it is about what is sent to a collector")

JPEG = {"content-type": "image/jpeg"}
TRACE, PARENT = "0af7651916cd43dd8448eb211c80319c", "b7ad6b7169203331"
CONTAINERS_GRACE_S = 10
"""What `docker stop` gives a container before it is killed."""
EXPORTER = "opentelemetry.exporter.otlp.proto.http.trace_exporter"


def settings(url: str) -> dict[str, str]:
    return {
        "REVISIT_TRACES": "true",
        "OTEL_EXPORTER_OTLP_ENDPOINT": url,
        "OTEL_EXPORTER_OTLP_COMPRESSION": "gzip",
        "OTEL_SERVICE_NAME": "places",
        "OTEL_BSP_SCHEDULE_DELAY": "200",
    }


def test_a_collector_gets_the_spans_of_a_query_in_the_callers_trace(tmp_path: Path) -> None:
    pytest.importorskip(EXPORTER, reason="NO COLLECTOR IS TRIED: the extra `otel` is not installed")
    # The first export meets a collector that is not ready: it is sent again.
    with collector(503) as kept, RunningService(tmp_path, **settings(kept.url)) as service:
        headers = JPEG | {"traceparent": f"00-{TRACE}-{PARENT}-01"}
        assert httpx.post(f"{service.url}/enroll", content=photo(), headers=JPEG, timeout=30).status_code == 201
        answer = httpx.post(f"{service.url}/query", content=photo(), headers=headers, timeout=30)
        assert service.stop() == 0  # what was not sent yet is sent at the end
    spans = {span.name: (sender, span) for sender, span in kept.spans() if span.trace_id.hex() == TRACE}
    sender, whole = spans.pop("POST /query")
    assert kept.content_types == {"application/x-protobuf"}
    assert sender["service.name"] == "places"
    assert whole.parent_span_id.hex() == PARENT
    facts = {each.key: each.value for each in whole.attributes}
    assert facts["revisit.request_id"].string_value == answer.headers["x-request-id"]
    assert facts["http.response.status_code"].int_value == 200
    assert {"query decode", "query encode", "query search"} <= spans.keys()
    assert {span.parent_span_id for _, span in spans.values()} == {whole.span_id}
    assert {span.name for _, span in kept.spans()} >= {"POST /enroll", "enroll decode"}
    assert not {span.name for _, span in kept.spans()} & {"GET /readyz", "GET /livez"}


@pytest.fixture(params=["gone", "silent"])
def deaf(request: pytest.FixtureRequest) -> Iterator[str]:
    """Address of a collector that takes nothing: its port is closed, or it takes connections and says no more."""
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        if request.param == "silent":
            listening.listen(100)
        yield f"http://127.0.0.1:{listening.getsockname()[1]}"


def test_a_deaf_collector_delays_no_caller_and_a_stop_by_three_seconds(tmp_path: Path, deaf: str) -> None:
    pytest.importorskip(EXPORTER, reason="NO COLLECTOR IS TRIED: the extra `otel` is not installed")
    with RunningService(tmp_path, **settings(deaf)) as service:
        for _ in range(20):
            began = time.monotonic()
            assert httpx.get(f"{service.url}/maps", timeout=30).status_code == 200
            assert time.monotonic() - began < CONTAINERS_GRACE_S / 2  # half of what one export may take
        began = time.monotonic()
        assert service.stop() == 0
        assert time.monotonic() - began < CONTAINERS_GRACE_S
    assert "the last spans are lost" in "".join(service.output)
