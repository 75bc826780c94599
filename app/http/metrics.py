"""What `/metrics` counts when it happens; each service has a registry of its own, so that several fit into a process.

Names and units follow https://prometheus.io/docs/practices/naming/. No label holds an id, a path or a caller.
"""

from collections.abc import Callable, Mapping

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    PlatformCollector,
    ProcessCollector,
    generate_latest as _generate,
)
from prometheus_client.exposition import CONTENT_TYPE_LATEST

from app.http.statistics import StatisticsCollector
from schemas.wire import QueryAnswer

MEDIA_TYPE = CONTENT_TYPE_LATEST

# Bounds of the buckets: from a cached answer to a batch of large images on a slow machine.
_SECONDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10, 30, 60)

LIMITS = {
    "too-many-requests": "queue",
    "body-too-large": "body-bytes",
    "picture-too-large": "image-pixels",
    "request-timeout": "slow-body",
}
"""Problem types that say that a limit was reached, and the value of the label `reason`."""

OnStages = Callable[[str, Mapping[str, float]], None]
"""Called with the operation and the milliseconds of each stage, in the order in which they ran."""


class Metrics:
    """Counters and histograms of one service; `statistics` has the gauges."""

    def __init__(self) -> None:
        self.registry = registry = CollectorRegistry()
        self.statistics = StatisticsCollector()
        self.on_stages: list[OnStages] = []
        registry.register(self.statistics)
        ProcessCollector(registry=registry)
        PlatformCollector(registry=registry)
        labels = ["method", "route"]
        self._requests = Counter(
            "revisit_http_requests", "Requests answered, by status class.", [*labels, "status"], registry=registry
        )
        self._seconds = Histogram(
            "revisit_http_request_duration_seconds",
            "From the first byte of a request to the last of its answer.",
            labels,
            buckets=_SECONDS,
            registry=registry,
        )
        self.in_flight = Gauge("revisit_http_requests_in_flight", "Requests being answered.", registry=registry)
        self._received = Counter("revisit_http_request_bytes", "Bytes of bodies read.", labels, registry=registry)
        self._sent = Counter("revisit_http_response_bytes", "Bytes of bodies sent.", labels, registry=registry)
        self._problems = Counter("revisit_http_problems", "Errors answered, by type.", ["type"], registry=registry)
        self._rejected = Counter(
            "revisit_rejected", "Requests or images refused by a limit.", ["reason"], registry=registry
        )
        self._stages = Histogram(
            "revisit_stage_duration_seconds",
            "Time of each stage of enrolments and queries.",
            ["operation", "stage"],
            buckets=_SECONDS,
            registry=registry,
        )
        self._events = {
            "webhooks": Counter(
                "revisit_webhooks", "Webhooks, by what became of them.", ["outcome"], registry=registry
            ),
            "mqtt": Counter("revisit_mqtt", "Events for MQTT, by what became of them.", ["outcome"], registry=registry),
        }
        self._verdicts = Counter(
            "revisit_query_verdicts", "Queries answered, by verdict.", ["status", "reason"], registry=registry
        )

    def answered(
        self, method: str, route: str, status: int, seconds: float, *, received: int = 0, sent: int = 0
    ) -> None:
        """Count a request.

        Parameters
        ----------
        method : str
        route : str
            Its template, so that ids do not become labels.
        status : int
            0 when the connection broke before there was an answer.
        seconds : float
        received, sent : int
            Bytes of the two bodies.
        """
        self._requests.labels(method, route, f"{status // 100}xx" if status else "none").inc()
        self._seconds.labels(method, route).observe(seconds)
        self._received.labels(method, route).inc(received)
        self._sent.labels(method, route).inc(sent)

    def refused(self, code: str, limit: str | None = None) -> None:
        """Count an error by its problem type; one that says that a limit was reached is counted as a rejection too.

        Parameters
        ----------
        code : str
        limit : str, optional
            Which limit, where the problem type does not tell.
        """
        self._problems.labels(code).inc()
        if code in LIMITS:
            self._rejected.labels(limit or LIMITS[code]).inc()

    def queried(self, answer: QueryAnswer) -> None:
        """Count the answer to a query, and record its stages."""
        self._verdicts.labels(answer.status, answer.reason.code).inc()
        self.stages("query", answer.timing_ms)

    def event(self, teller: str, outcome: str) -> None:
        """Count what became of an event that a teller was given."""
        self._events[teller].labels(outcome).inc()

    def stages(self, operation: str, timing_ms: Mapping[str, float]) -> None:
        """Record the time of each stage of an answer, in ms."""
        for stage, milliseconds in timing_ms.items():
            self._stages.labels(operation, stage).observe(milliseconds / 1000)
        for told in self.on_stages:
            told(operation, timing_ms)

    def text(self) -> bytes:
        """All metrics in Prometheus's text format."""
        return _generate(self.registry)
