"""The metrics of `/metrics`; each service has a registry of its own, so that several fit into one process."""

from collections.abc import Mapping

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest
from prometheus_client.exposition import CONTENT_TYPE_LATEST

from schemas.wire import MapFacts

MEDIA_TYPE = CONTENT_TYPE_LATEST

# Bounds of the buckets: from a cached answer to a batch of large images on a slow machine.
_SECONDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30)


class Metrics:
    """Counters, histograms and gauges of one service."""

    def __init__(self) -> None:
        self._registry = CollectorRegistry()
        self._requests = Counter(
            "revisit_requests", "Requests answered.", ["method", "route", "status"], registry=self._registry
        )
        self._seconds = Histogram(
            "revisit_request_seconds",
            "From the first byte of a request to the last of its answer.",
            ["method", "route"],
            buckets=_SECONDS,
            registry=self._registry,
        )
        self._stages = Histogram(
            "revisit_stage_seconds",
            "Time of each stage of enrolments and queries.",
            ["operation", "stage"],
            buckets=_SECONDS,
            registry=self._registry,
        )
        self._queue = Gauge("revisit_queue_length", "Images waiting to be described.", registry=self._registry)
        self._views = Gauge("revisit_views", "Views of each map by state.", ["map", "state"], registry=self._registry)
        self._revisions = Gauge("revisit_map_revision", "Revision of each map.", ["map"], registry=self._registry)

    def answered(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count a request; `route` is its template, so that ids do not become labels."""
        self._requests.labels(method, route, str(status)).inc()
        self._seconds.labels(method, route).observe(seconds)

    def stages(self, operation: str, timing_ms: Mapping[str, float]) -> None:
        """Record the time of each stage of an answer, in ms."""
        for stage, milliseconds in timing_ms.items():
            self._stages.labels(operation, stage).observe(milliseconds / 1000)

    def state(self, queue_length: int, maps: list[MapFacts]) -> None:
        """Set the gauges; maps that no longer exist disappear."""
        self._queue.set(queue_length)
        self._views.clear()
        self._revisions.clear()
        for facts in maps:
            self._revisions.labels(facts.name).set(facts.revision)
            for state, count in facts.views.items():
                self._views.labels(facts.name, state).set(count)

    def text(self) -> bytes:
        """All metrics in Prometheus's text format."""
        return generate_latest(self._registry)
