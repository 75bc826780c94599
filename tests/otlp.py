"""A collector of OpenTelemetry traces, as small as can be: OTLP over HTTP, read by the official messages."""

import gzip
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest


class Collector:
    """What was received, and where it listens."""

    def __init__(self, url: str, status: list[int]) -> None:
        self.url = url
        self.exports: list[Any] = []
        self.content_types: set[str] = set()
        self.statuses = status

    def spans(self) -> list[tuple[dict[str, str], Any]]:
        """Each span with the text attributes of what sent it."""
        return [
            ({each.key: each.value.string_value for each in sent.resource.attributes}, span)
            for export in self.exports
            for sent in export.resource_spans
            for scope in sent.scope_spans
            for span in scope.spans
        ]


@contextmanager
def collector(*statuses: int) -> Iterator[Collector]:
    """A collector on a free port; answers its first exports with `statuses`, and then 200."""
    messages = pytest.importorskip(
        "opentelemetry.proto.collector.trace.v1.trace_service_pb2",
        reason="NO COLLECTOR IS TRIED: the extra `otel` is not installed",
    )

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            status = kept.statuses.pop(0) if kept.statuses else 200
            if status == 200 and self.path == "/v1/traces":
                plain = gzip.decompress(body) if self.headers.get("Content-Encoding") == "gzip" else body
                kept.content_types.add(self.headers["Content-Type"])
                kept.exports.append(messages.ExportTraceServiceRequest.FromString(plain))
            answer = messages.ExportTraceServiceResponse().SerializeToString()
            self.send_response(status if self.path == "/v1/traces" else 404)
            self.send_header("Content-Type", "application/x-protobuf")
            self.send_header("Content-Length", str(len(answer)))
            self.end_headers()
            self.wfile.write(answer)

        def log_message(self, format: str, *arguments: Any) -> None:
            """Nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        kept = Collector(f"http://127.0.0.1:{server.server_port}", list(statuses))
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        try:
            yield kept
        finally:
            server.shutdown()
            thread.join()
