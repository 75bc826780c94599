"""OpenTelemetry traces, off unless `REVISIT_TRACES` is set: a span for each request and one for each of its stages.

The standard variables ``OTEL_*`` say where traces go; nothing of OpenTelemetry is imported while traces are off.
"""

import logging
import os
import threading
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING, Any

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from schemas.errors import SetupError
from schemas.log_context import bound

if TYPE_CHECKING:
    from app.http.metrics import Metrics

logger = logging.getLogger("revisit.http")

PATIENCE_S = 3.0
"""Seconds that a stop waits for the collector to take the last spans."""

EXTRA = (
    "REVISIT_TRACES needs two packages: pip install opentelemetry-sdk opentelemetry-exporter-otlp-proto-http "
    "(the extra 'otel'), or leave REVISIT_TRACES out"
)

WITHOUT_SPANS = frozenset({"/livez", "/readyz", "/metrics"})
"""Asked every few seconds by supervisors: their spans would hide all others."""


class Tracing:
    """Middleware around every route; continues the caller's trace (W3C Trace Context, header ``traceparent``).

    Parameters
    ----------
    app : ASGIApp
    provider : TracerProvider
        Of OpenTelemetry.
    metrics : Metrics
        Tells the times of the stages.
    """

    def __init__(self, app: ASGIApp, provider: Any, metrics: "Metrics") -> None:
        self._app, self._provider = app, provider
        self._tracer = provider.get_tracer("revisit")
        metrics.on_stages.append(self._stages)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request within a span."""
        if scope["type"] != "http" or scope["path"] in WITHOUT_SPANS:
            await self._app(scope, receive, send)
            return
        from opentelemetry import propagate
        from opentelemetry.trace import SpanKind, StatusCode

        parent = propagate.extract(dict(Headers(scope=scope)))
        facts = {"http.request.method": scope["method"], "revisit.request_id": scope["state"]["request_id"]}
        with self._tracer.start_as_current_span(
            scope["method"], parent, SpanKind.SERVER, facts, record_exception=False, set_status_on_exception=False
        ) as span:

            async def send_seen(message: Message) -> None:
                if message["type"] == "http.response.start":
                    span.set_attribute("http.response.status_code", message["status"])
                    if message["status"] >= 500:
                        span.set_status(StatusCode.ERROR)
                await send(message)

            try:
                with _logged(span):
                    await self._app(scope, receive, send_seen)
            except Exception as error:
                # The type alone: messages may hold what is private, and the log has the traceback.
                span.set_attribute("error.type", type(error).__name__)
                span.set_status(StatusCode.ERROR)
                raise
            # The template of the route is known once the router has seen the request; ids stay out of names.
            route = getattr(scope.get("route"), "path", None)
            if route is not None:
                span.update_name(f"{scope['method']} {route}")
                span.set_attribute("http.route", route)

    def _stages(self, operation: str, timing_ms: Mapping[str, float]) -> None:
        """Add a span for each stage. Stages are measured as durations: their spans are laid end to end, up to now."""
        stages = {stage: round(ms * 1e6) for stage, ms in timing_ms.items() if stage != "total"}
        begin = time.time_ns() - sum(stages.values())
        for stage, nanoseconds in stages.items():
            self._tracer.start_span(f"{operation} {stage}", start_time=begin).end(begin + nanoseconds)
            begin += nanoseconds


def _logged(span: Any) -> AbstractContextManager[None]:
    """The trace's id in every log line."""
    context = span.get_span_context()
    return bound(trace_id=f"{context.trace_id:032x}") if context.is_valid else nullcontext()


def make_provider() -> Any:
    """A provider that sends spans as the variables ``OTEL_*`` say.

    Raises
    ------
    SetupError
        OpenTelemetry is not installed, an exporter is asked for that is not known here, or a variable has a value that
        cannot be used.
    """
    try:
        return _provider()
    except ValueError as error:
        raise SetupError(f"a variable OTEL_* has a value that cannot be used: {error}") from None


def _provider() -> Any:
    try:
        from opentelemetry.sdk.resources import SERVICE_NAME, Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor, ConsoleSpanExporter
    except ModuleNotFoundError:
        raise SetupError(EXTRA) from None
    resource = Resource.create()
    if str(resource.attributes[SERVICE_NAME]).startswith("unknown_service"):  # no variable names it
        resource = resource.merge(Resource({SERVICE_NAME: "revisit"}))
    # `finish` sends what is left; at exit the exporter would take all the time it likes.
    provider = TracerProvider(resource=resource, shutdown_on_exit=False)
    exporter = os.environ.get("OTEL_TRACES_EXPORTER", "otlp")
    if exporter == "otlp":
        try:
            from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        except ModuleNotFoundError:
            raise SetupError(EXTRA) from None
        provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    elif exporter == "console":
        provider.add_span_processor(BatchSpanProcessor(ConsoleSpanExporter()))
    elif exporter != "none":
        raise SetupError(f"OTEL_TRACES_EXPORTER={exporter}: use otlp (over HTTP), console or none")
    return provider


def finish(provider: Any, patience_s: float = PATIENCE_S) -> None:
    """Send the spans that are left; returns after `patience_s` seconds at the latest, and logs what that costs.

    An exporter tries a collector that is away for ten seconds and more, which is all that containers get to stop.
    """
    # A thread of the pool would be waited for when the process exits.
    sending = threading.Thread(target=provider.shutdown, name="revisit-last-spans", daemon=True)
    sending.start()
    sending.join(patience_s)
    if sending.is_alive():
        logger.warning("the collector of traces took nothing for %.0f s; the last spans are lost", patience_s)
