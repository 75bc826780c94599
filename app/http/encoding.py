"""The application of a shared encoder: the Open Inference Protocol (KServe v2) over HTTP, for nodes without a GPU."""

import asyncio
import hmac
import json
from collections.abc import AsyncIterator, Callable, Sequence
from concurrent.futures import Future
from contextlib import asynccontextmanager
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Depends, FastAPI, Request
from fastapi.responses import JSONResponse, Response
from prometheus_client import Gauge, Histogram

from app.http import problems
from app.http.keys import presented
from app.http.metrics import MEDIA_TYPE as METRICS_TYPE, Metrics
from app.http.middleware import STARTING_RETRY_S, BodyLimit, ReadinessGate, RequestContext
from app.http.readiness import liveness
from app.version import VERSION
from schemas.description import SEMANTIC, PixelField
from schemas.errors import BadBody, EncoderAway, NotFound, RevisitError, Unauthorized
from schemas.image import Bytes2D
from schemas.inference import (
    COLUMNS,
    JSON_LENGTH,
    MEDIA_TYPE,
    OUTPUTS,
    PIXELS,
    QUERY_PRIORITY,
    ROWS,
    SEGMENTED,
    Tensor,
    packed,
    scale_name,
    unpacked,
)
from schemas.settings import Settings
from schemas.wire import Readiness
from worker.description.scheduler import Timed
from worker.service.encoding import EncodingService, stacked

PATIENCE_S = 30.0
"""Seconds that a caller waits who does not say how long (the parameter ``timeout``)."""

CHECK_S = 2.0
"""Seconds that the encoder has for a test image, and for which the result is given again."""

SIDE = 32
"""Sides of images are multiples of this many pixels, so that the network needs no padding."""

MOST_CELLS = 256
"""Rows or columns of a segmentation at most: twice those of any photo."""

LARGEST_NUMBER = 2**63
"""Of parameters, as the protocol has them: integers of 64 bits."""

_BATCHES = (1, 2, 4, 8, 16, 32, 64, 128)


class SharedEncoder:
    """What the routes share: the service, the key, and whether the process stops.

    Parameters
    ----------
    service : EncodingService
    key : str or None
        That callers must send; None lets everybody in.
    """

    def __init__(self, service: EncodingService, key: str | None) -> None:
        self.service, self._key = service, key
        self.started = self.draining = False
        self.metrics = Metrics()
        self._checked: tuple[float, str] | None = None
        self._checking: asyncio.Task[str] | None = None

    def drain(self) -> None:
        """Refuse what is new from now on."""
        self.draining = True

    def let_in(self, request: Request) -> None:
        """Raise Unauthorized unless the request sends the key."""
        if self._key is None:
            return
        sent = presented(request.headers) or ""
        if not hmac.compare_digest(sent.encode(), self._key.encode()):
            raise Unauthorized("send the value of REVISIT_ENCODER_KEY as Authorization: Bearer ...")

    async def check(self) -> str:
        """``ok``, or why no image can be encoded; the result of a trial that is at most `CHECK_S` old."""
        if self.draining or not self.started:
            return "stopping" if self.draining else "starting"
        now = asyncio.get_running_loop().time()
        if self._checked is not None and now - self._checked[0] < CHECK_S:
            return self._checked[1]
        state = await asyncio.shield(self._try())
        self._checked = asyncio.get_running_loop().time(), state
        return state

    def beyond_help(self) -> str | None:
        """What only a restart mends, in words; None while there is nothing of the kind."""
        if self.draining or not self.started:
            return None
        if self.service.away:
            self._try()  # nobody may send an image, which alone would tell whether it is so still
        return self.service.beyond_help

    def _try(self) -> "asyncio.Task[str]":
        """Begin to encode a test image, unless that is under way."""
        if self._checking is None or self._checking.done():
            self._checking = asyncio.create_task(asyncio.to_thread(self.service.check, CHECK_S))
        return self._checking


async def _shared(request: Request) -> SharedEncoder:
    shared: SharedEncoder = request.app.state.shared
    return shared


Shared = Annotated[SharedEncoder, Depends(_shared)]


async def _key(request: Request, shared: Shared) -> None:
    shared.let_in(request)


async def _model(model: str, shared: Shared) -> None:
    service = shared.service
    if model not in (service.model, service.segmenting_model):
        encoder = service.encoder
        raise NotFound(
            "model",
            model,
            f"there are {service.model}, the encoder {encoder.name} with weights {encoder.digest}, and "
            f"{service.segmenting_model or 'no segmenter'}",
        )


probes = APIRouter()
router = APIRouter(dependencies=[Depends(_key)])
of_model = APIRouter(prefix="/v2/models/{model}", dependencies=[Depends(_key), Depends(_model)])


@probes.get("/livez")
@probes.get("/v2/health/live")
async def live(shared: Shared) -> Response:
    """Whether the process answers, and a restart would not help."""
    return liveness(shared.beyond_help())


@probes.get("/readyz")
@probes.get("/v2/health/ready")
async def ready(shared: Shared) -> Response:
    """Whether images can be encoded now, found out by encoding one."""
    state = await shared.check()
    status, headers = (200, {}) if state == "ok" else (503, {"Retry-After": str(STARTING_RETRY_S)})
    return JSONResponse(Readiness(ready=state == "ok", checks={"encoder": state}).model_dump(), status, headers)


@router.get("/v2")
async def server() -> dict[str, Any]:
    """What this server is."""
    return {"name": "revisit", "version": VERSION, "extensions": ["binary_tensor_data", "schedule_policy"]}


@router.get("/metrics")
async def metrics(shared: Shared) -> Response:
    """Metrics in Prometheus's text format."""
    shared.metrics.statistics.state = "draining" if shared.draining else "ready" if shared.started else "starting"
    return Response(shared.metrics.text(), media_type=METRICS_TYPE)


@of_model.get("")
async def model(model: str, shared: Shared) -> dict[str, Any]:
    """The tensors of a model."""
    service = shared.service
    channels = service.encoder.layers
    if service.segmenter is not None and model == service.segmenting_model:
        inputs = [(scale_name(number), [1, -1, -1, 3]) for number in range(service.segmenter.scales)]
        outputs = [(SEGMENTED, [1, -1, -1, channels[SEMANTIC]])]
    else:
        inputs = [(PIXELS, [-1, -1, -1, 3])]
        outputs = [(name, [-1, -1, -1, channels[layer]]) for layer, name in OUTPUTS.items()]
    return {
        "name": model,
        "versions": ["1"],
        "platform": "revisit",
        "inputs": [{"name": name, "datatype": "UINT8", "shape": shape} for name, shape in inputs],
        "outputs": [{"name": name, "datatype": "FP32", "shape": shape} for name, shape in outputs],
    }


@of_model.get("/ready")
async def model_ready(shared: Shared) -> Response:
    """Whether images can be encoded now."""
    return await ready(shared)


@of_model.post("/infer")
@of_model.post("/versions/1/infer")
async def infer(model: str, request: Request, shared: Shared) -> Response:
    """Layers of images, batched with those of others, or the segmentation of one."""
    service = shared.service
    message, sent = unpacked("inputs", request.headers.get(JSON_LENGTH), await request.body())
    parameters = _parameters(message)
    urgent = parameters.get("priority", 0) in (0, QUERY_PRIORITY)
    patience_s = parameters.get("timeout", 0) / 1_000_000 or PATIENCE_S
    if service.segmenter is not None and model == service.segmenting_model:
        scales, grid = _scales(sent, service.segmenter.scales), _grid(parameters)
        [field] = await _results([service.submit_segmentation(scales, grid, urgent=urgent)], patience_s)
        tensors: dict[str, Tensor] = {SEGMENTED: field.semantic[None]}
    else:
        wanted = _wanted(message)
        fields = await _results(service.submit(_pixels(sent), urgent=urgent), patience_s)
        layers = await asyncio.to_thread(stacked, fields)
        tensors = {name: layers[layer] for layer, name in OUTPUTS.items() if name in wanted}
    said = {"model_name": model, "model_version": "1"}
    if isinstance(message.get("id"), str):
        said["id"] = message["id"]
    length, body = packed("outputs", tensors, said)
    return Response(body, media_type=MEDIA_TYPE, headers={JSON_LENGTH: str(length)})


def _pixels(tensors: dict[str, Tensor]) -> Bytes2D:
    """The images of a request, uint8 of shape (n, height, width, 3)."""
    pixels = tensors.get(PIXELS)
    if pixels is None or len(tensors) != 1 or not _are_images(pixels):
        raise BadBody(
            "malformed-body",
            f"needed is one input {PIXELS}, uint8 of shape (n, height, width, 3), sides multiples of {SIDE}; "
            f"sent were {_seen(tensors)}",
        )
    return np.asarray(pixels, np.uint8)


def _scales(tensors: dict[str, Tensor], count: int) -> list[Bytes2D]:
    """The image of a request at each scale, uint8 of shape (height, width, 3)."""
    names = [scale_name(number) for number in range(count)]
    found = [tensors[name] for name in names if name in tensors]
    if len(found) != len(tensors) or len(found) != count or not all(len(t) == 1 and _are_images(t) for t in found):
        raise BadBody(
            "malformed-body",
            f"needed are the inputs {', '.join(names)}, uint8 of shape (1, height, width, 3), sides multiples of "
            f"{SIDE}; sent were {_seen(tensors)}",
        )
    return [np.asarray(one[0], np.uint8) for one in found]


def _grid(parameters: dict[str, int]) -> tuple[int, int]:
    """Rows and columns of a segmentation."""
    rows, columns = parameters.get(ROWS, 0), parameters.get(COLUMNS, 0)
    if not (1 <= rows <= MOST_CELLS and 1 <= columns <= MOST_CELLS):
        raise BadBody(
            "malformed-body",
            f"parameters.{ROWS} and parameters.{COLUMNS} are 1 to {MOST_CELLS}, not {rows} and {columns}",
        )
    return rows, columns


def _are_images(tensor: Tensor) -> bool:
    shape = tensor.shape
    return (
        tensor.dtype == np.uint8 and len(shape) == 4 and shape[3] == 3 and not any(side % SIDE for side in shape[1:3])
    )


def _seen(tensors: dict[str, Tensor]) -> dict[str, tuple[str, tuple[int, ...]]]:
    return {name: (str(tensor.dtype), tensor.shape) for name, tensor in tensors.items()}


def _parameters(message: dict[str, Any]) -> dict[str, int]:
    """The numbers among the parameters of a request."""
    given = message.get("parameters", {})
    if not isinstance(given, dict):
        raise BadBody("malformed-body", f"parameters are an object, not {given!r:.50}")
    numbers = {name: given[name] for name in ("priority", "timeout", ROWS, COLUMNS) if name in given}
    for name, value in numbers.items():
        if type(value) is not int or not 0 <= value < LARGEST_NUMBER:
            raise BadBody("malformed-body", f"parameters.{name} is a number of 0 to 2^63, not {value!r:.50}")
    return numbers


def _wanted(message: dict[str, Any]) -> set[str]:
    """Names of the outputs that a request names; all where it names none."""
    outputs = message.get("outputs") or [{"name": name} for name in OUTPUTS.values()]
    names = {str(one.get("name")) for one in outputs if isinstance(one, dict)} if isinstance(outputs, list) else set()
    if not names or not names <= set(OUTPUTS.values()):
        raise BadBody("malformed-body", f"outputs are among {', '.join(OUTPUTS.values())}")
    return names


async def _results(futures: Sequence["Future[Timed[PixelField]]"], patience_s: float) -> list[PixelField]:
    """Fields of all images; those that still wait when time is up are not encoded any more."""
    tasks = [asyncio.wrap_future(future) for future in futures]
    try:
        async with asyncio.timeout(patience_s):
            return [timed.value for timed in await asyncio.gather(*tasks)]
    except TimeoutError:
        raise EncoderAway(f"the encoder was not done within {patience_s:.1f} s; try again in 1 s", 1) from None
    finally:
        for future in futures:
            future.cancel()


async def _refused(request: Request, error: Exception) -> Response:
    """Answer a problem that also has the member that the protocol names: ``error``."""
    assert isinstance(error, RevisitError)
    answer = problems.problem_of(error, problems.request_id(request))
    said = json.loads(bytes(answer.body))
    kept = {name: value for name, value in answer.headers.items() if name in ("retry-after", "www-authenticate")}
    return JSONResponse({**said, "error": said["detail"]}, answer.status_code, kept, problems.MEDIA_TYPE)


def encoder_application(
    make_service: Callable[[Callable[[int], None]], EncodingService], settings: Settings
) -> FastAPI:
    """The application of a shared encoder; the service starts and stops with it.

    Parameters
    ----------
    make_service : function
        Makes the service from what is to be told the size of each batch.
    settings : Settings
        Key, largest body, and the time for it.
    """
    key = None if settings.encoder_key is None else settings.encoder_key.get_secret_value()
    shared = SharedEncoder(make_service(lambda count: batches.observe(count)), key)
    registry = shared.metrics.registry
    batches = Histogram(
        "revisit_encoder_batch_images", "Images that went through the network together.", buckets=_BATCHES,
        registry=registry,
    )  # fmt: skip
    waiting = Gauge("revisit_encoder_images_waiting", "Images that wait or are in the network.", registry=registry)
    waiting.set_function(lambda: shared.service.waiting)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        shared.service.start()
        shared.started = True
        try:
            yield
        finally:
            shared.drain()
            await asyncio.to_thread(shared.service.stop)

    app = FastAPI(title="revisit encode", version=VERSION, lifespan=lifespan, docs_url=None, redoc_url=None,
                  openapi_url=None, redirect_slashes=False,
                  routes=[*probes.routes, *router.routes, *of_model.routes])  # fmt: skip
    app.state.shared = shared
    problems.install(app)
    app.add_exception_handler(RevisitError, _refused)
    app.add_middleware(BodyLimit, settings=settings)
    app.add_middleware(ReadinessGate, state=lambda: (shared.started, shared.draining))
    app.add_middleware(RequestContext, metrics=shared.metrics, draining=lambda: shared.draining, slow_s=settings.slow_s)
    return app
