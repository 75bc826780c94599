"""Dependencies of the routes: the use-cases, the metrics, checked path and query parameters."""

from typing import Annotated

from fastapi import Depends, Path, Query, Request

from app.http.body import refuse_body
from app.http.curate import Curator
from app.http.lifecycle import Lifecycle
from app.http.metrics import Metrics
from app.http.parameters import NoParameters
from app.http.recognise import Recogniser
from app.http.validation import OnceEach
from app.http.values import MAP_NAME


async def _recogniser(request: Request) -> Recogniser:
    recogniser: Recogniser = request.app.state.service.recogniser
    return recogniser


async def _curator(request: Request) -> Curator:
    curator: Curator = request.app.state.service.curator
    return curator


async def _lifecycle(request: Request) -> Lifecycle:
    lifecycle: Lifecycle = request.app.state.service.lifecycle
    return lifecycle


async def _metrics(request: Request) -> Metrics:
    metrics: Metrics = request.app.state.metrics
    return metrics


Recognises = Annotated[Recogniser, Depends(_recogniser)]
Curates = Annotated[Curator, Depends(_curator)]
Lifecycles = Annotated[Lifecycle, Depends(_lifecycle)]
Measures = Annotated[Metrics, Depends(_metrics)]


MapName = Annotated[str, Path(alias="map", pattern=MAP_NAME, description="Name of the map.")]
ViewId = Annotated[str, Path(description="Id of the view.")]
JobId = Annotated[str, Path(description="Id of the job.")]
QueryId = Annotated[str, Path(description="Id of the query, from its answer.")]


async def _once_each(_: Annotated[OnceEach, Query()]) -> None: ...


async def _no_parameters(_: Annotated[NoParameters, Query()]) -> None: ...


async def _documented_body(request: Request) -> None:
    if "requestBody" not in (request.scope["route"].openapi_extra or {}):
        await refuse_body(request)


documented_body = Depends(_documented_body)
"""For all routes: a body is an error where the OpenAPI document has none, instead of being ignored."""

once_each = Depends(_once_each)
"""For routes whose parameters FastAPI reads: a repeated parameter is an error."""

no_parameters = Depends(_no_parameters)
"""For routes without parameters: an unknown parameter is an error instead of being ignored."""
