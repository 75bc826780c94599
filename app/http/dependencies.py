"""What a route is given: the use-cases, the metrics, and its parameters, checked."""

from collections.abc import Awaitable, Callable
from typing import Annotated, TypeVar

from fastapi import Depends, Request

from app.http.curate import Curator
from app.http.lifecycle import Lifecycle
from app.http.metrics import Metrics
from app.http.parameters import MapName, NoParameters, Parameters, read, validated
from app.http.recognise import Recogniser

P = TypeVar("P", bound=Parameters)


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


def in_url(model: type[P]) -> Callable[[Request], Awaitable[P]]:
    """A dependency that reads a model from the URL's query; raises InvalidParameters."""

    async def read_url(request: Request) -> P:
        return read(model, request.query_params.multi_items())

    return read_url


no_parameters = Depends(in_url(NoParameters))
"""For routes that take none: an unknown parameter is an error, not ignored."""


class _MapPath(Parameters):
    map: MapName


async def map_in_path(request: Request) -> str:
    """The map's name from the path; raises InvalidParameters."""
    return validated(_MapPath, {"map": request.path_params["map"]}).map
