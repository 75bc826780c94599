"""Calls a server of models by the Open Inference Protocol (KServe v2), so that its failures cost little time.

One that does not answer is given up after some seconds; from then on calls fail at once, and now and again one of them
tries it with a small image first. So a query never waits for a server that was silent a moment ago.
"""

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import httpx
import numpy as np

from schemas.description import SEMANTIC, Floats
from schemas.errors import NOT_CALLED, BadBody, EncoderAway, SetupError
from schemas.image import Bytes2D, PreparedImage
from schemas.inference import (
    COLUMNS,
    ENROLMENT_PRIORITY,
    JSON_LENGTH,
    MEDIA_TYPE,
    OUTPUTS,
    PIXELS,
    PROBE,
    QUERY_PRIORITY,
    ROWS,
    SEGMENTED,
    STRIDE,
    Tensor,
    packed,
    scale_name,
    unpacked,
)

CONNECT_S = 2.0
"""Seconds for a connection to be made."""

PROBE_S = 2.0
"""Seconds that a server which failed has to answer the small image."""

REST_S, MOST_REST_S = 1, 5
"""Seconds after a failure in which calls fail at once: the first, or what the server asks for up to the second."""

IDLE_S = 3.0
"""Seconds for which a silent connection is kept: less than servers keep it (revisit: 5 s)."""

SEGMENTED_WITHIN = 2
"""Times that a segmentation may take as long to be begun as a description: it takes as much work as a dozen of them."""

UNIT_WITHIN = 0.01
"""By how much lengths of the vectors that it answers may differ from 1: it may compute in halves of our precision."""

ROOM = 1_000_000
"""Bytes that an answer may have beside twice those of its outputs: its JSON, or what a refusal says."""

_LONGEST_WORD, _MOST_DIGITS = 300, 9


class UnknownModel(EncoderAway):
    """The server does not have these weights, or does not let this process in: time alone mends neither."""


class _TooLong(Exception):
    """An answer goes on beyond so many bytes."""


class FailedImage(Exception):
    """The server failed on these images, or gave for them what is no field; on others it may not."""


@dataclass(frozen=True)
class _Call:
    """One call of a model: what it gets, what it is told besides, and the outputs by the names that they get here.

    `shape` is that of each output, without its channels: images, rows and columns. The answer may take `within` times
    the server's usual time to begin.
    """

    model: str
    inputs: Mapping[str, Tensor]
    outputs: Mapping[str, str]
    shape: tuple[int, int, int]
    parameters: Mapping[str, int]
    urgent: bool
    within: int = 1

    def most_bytes(self, channels: Mapping[str, int]) -> int:
        """Of its answer, for layers of so many channels: the server may have outputs that are not used."""
        numbers = math.prod(self.shape) * sum(channels[layer] for layer in self.outputs)
        return 2 * numbers * np.dtype(np.float32).itemsize + ROOM


class InferenceClient:
    """The encoder of a server, and its segmenter.

    Parameters
    ----------
    url : str
        Of the server, without ``/v2``.
    model : str
        Its name, which says which weights are meant: `schemas.inference.model_name`.
    channels : mapping of layer to int
        Of what these weights give.
    key : str or None
        Sent as ``Authorization: Bearer``.
    patience_s : float
        Seconds in which the server must take a request, begin its answer, and end it, each. The answer to a
        segmentation may take `SEGMENTED_WITHIN` times as long to begin.
    clock : function
        Monotonic seconds.

    Raises
    ------
    SetupError
        The environment names a proxy or certificates that cannot be used.
    """

    def __init__(
        self,
        url: str,
        model: str,
        channels: Mapping[str, int],
        key: str | None = None,
        patience_s: float = 7.5,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._place, self._model, self._patience_s, self._clock = url.rstrip("/"), model, patience_s, clock
        self._channels = {**channels, SEGMENTED: channels[SEMANTIC]}
        headers = {"user-agent": "revisit", "content-type": MEDIA_TYPE, "accept-encoding": "identity"}
        if key is not None:
            headers["authorization"] = f"Bearer {key}"
        try:
            self._http = httpx.Client(headers=headers, limits=httpx.Limits(keepalive_expiry=IDLE_S))
        except (ImportError, OSError, ValueError, httpx.InvalidURL) as error:
            raise SetupError(NOT_CALLED.format("REVISIT_ENCODER_URL", error)) from error
        self._troubles: dict[str, tuple[EncoderAway, float]] = {}  # by model: why, and when it is tried again

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def probe(self) -> None:
        """Have a small image encoded; raises EncoderAway, of which UnknownModel says that the set-up is wrong."""
        try:
            self._call(self._encoding(PROBE, urgent=True), min(PROBE_S, self._patience_s))
        except FailedImage as error:
            raise self._away(f"fails on a test image ({error})") from None

    def has(self, model: str) -> bool:
        """Whether the server has a model; raises EncoderAway."""
        try:
            answer = self._http.get(f"{self._place}/v2/models/{model}", timeout=min(PROBE_S, self._patience_s))
        except httpx.HTTPError as error:
            raise self._away(f"cannot be reached ({str(error) or type(error).__name__})") from None
        if answer.status_code in (400, 404):
            return False
        if answer.status_code != 200:
            refused = self._refused(model, answer.status_code, answer.headers, answer.content)
            raise self._away(str(refused)) if isinstance(refused, FailedImage) else refused
        return True

    def fields(self, pixels: Bytes2D, *, urgent: bool) -> Mapping[str, Floats]:
        """Layers of images of one size.

        Parameters
        ----------
        pixels : uint8 of shape (n, height, width, 3)
        urgent : bool
            Whether they go before those that are not.

        Returns
        -------
        mapping of layer to float32 of shape (n, rows, columns, channels)

        Raises
        ------
        EncoderAway
            The server cannot be had now; the detail names it and says why.
        FailedImage
        """
        return self._answered(self._encoding(pixels, urgent=urgent))

    def segmentation(self, model: str, image: PreparedImage, *, urgent: bool) -> Floats:
        """The segmentation of an image by another model of the server; raises as `fields`.

        Returns
        -------
        float32 of shape (rows, columns, channels)
        """
        inputs = {scale_name(number): scale[None] for number, scale in enumerate(image.scales)}
        rows, columns = image.grid
        outputs, told = {SEGMENTED: SEGMENTED}, {ROWS: rows, COLUMNS: columns}
        call = _Call(model, inputs, outputs, (1, rows, columns), told, urgent, SEGMENTED_WITHIN)
        layer: Floats = self._answered(call)[SEGMENTED][0]
        return layer

    def _encoding(self, pixels: Bytes2D, *, urgent: bool) -> _Call:
        count, height, width = pixels.shape[:3]
        shape = count, height // STRIDE, width // STRIDE
        return _Call(self._model, {PIXELS: pixels}, OUTPUTS, shape, {}, urgent)

    def _answered(self, call: _Call) -> Mapping[str, Floats]:
        """What the server answers, unless this model of it failed a moment ago."""
        trouble, again_at = self._troubles.get(call.model, (None, 0.0))
        if trouble is not None and self._clock() < again_at:
            raise EncoderAway(trouble.detail, trouble.retry_after_s)
        try:
            if trouble is not None:
                self.probe()
            try:
                found = self._call(call, self._patience_s)
            except FailedImage:
                self.probe()  # if it fails on every image, these are not to blame
                raise
        except EncoderAway as error:
            self._troubles[call.model] = error, self._clock() + error.retry_after_s
            raise
        self._troubles.pop(call.model, None)
        return found

    def _call(self, call: _Call, patience_s: float) -> Mapping[str, Floats]:
        begun_s = call.within * patience_s
        wanted = {
            "parameters": {
                "binary_data_output": True,
                "priority": QUERY_PRIORITY if call.urgent else ENROLMENT_PRIORITY,
                "timeout": round(begun_s * 1_000_000),
                **call.parameters,
            }
        }
        length, body = packed("inputs", call.inputs, wanted)
        most = call.most_bytes(self._channels)
        post = partial(self._post, call.model, length, body, most, patience_s, begun_s)
        try:
            try:
                status, headers, content = post()
                if status == 503 and headers.get("connection") == "close":
                    # It stops; behind the same address there may be another.
                    status, headers, content = post()
            except (httpx.RemoteProtocolError, httpx.ReadError, httpx.WriteError):
                # It had closed a connection that was kept: encoding twice does no harm.
                status, headers, content = post()
        except _TooLong:
            raise self._away(f"answers more than {most:,} bytes") from None
        except httpx.TimeoutException:
            raise self._away(f"does not answer within {begun_s:.1f} s") from None
        except httpx.HTTPError as error:
            raise self._away(f"cannot be reached ({str(error) or type(error).__name__})") from None
        if status != 200:
            raise self._refused(call.model, status, headers, content)
        try:
            _, tensors = unpacked("outputs", headers.get(JSON_LENGTH), content)
            layers = _layers(tensors, call, self._channels)
        except BadBody as error:
            raise self._away(f"gives an answer of another kind: {error.detail}") from None
        for layer, field in layers.items():
            if not _is_unit(field):
                name = call.outputs[layer]
                raise FailedImage(f"the encoder at {self._place} gives vectors in {name} that are not of unit length")
        return layers

    def _post(
        self, model: str, length: int, body: bytes, most_bytes: int, patience_s: float, begun_s: float
    ) -> tuple[int, httpx.Headers, bytes]:
        until = self._clock() + begun_s
        timeout = httpx.Timeout(patience_s, connect=min(CONNECT_S, patience_s), read=begun_s)
        address = f"{self._place}/v2/models/{model}/infer"
        with self._http.stream(
            "POST", address, content=body, headers={JSON_LENGTH: str(length)}, timeout=timeout
        ) as answer:
            begun = self._clock()
            chunks, room = [], most_bytes
            for chunk in answer.iter_raw():  # each of them has its own time, and all together have it once more
                chunks.append(chunk)
                room -= len(chunk)
                if room < 0:
                    raise _TooLong
                if self._clock() > max(until, begun + patience_s):
                    raise httpx.ReadTimeout("the answer does not end")
        return answer.status_code, answer.headers, b"".join(chunks)

    def _refused(self, model: str, status: int, headers: httpx.Headers, content: bytes) -> Exception:
        said = _said(content)
        if status in (400, 404):  # Triton's answer to an unknown model was 400 until 2023
            return UnknownModel(
                f"the encoder at {self._place} does not have the model {model}, which is the encoder and weights "
                f"of this version; run the same version of revisit there (it answers {status}: {said})",
                REST_S,
            )
        if status in (401, 403):
            return UnknownModel(
                f"the encoder at {self._place} refuses the key; give both REVISIT_ENCODER_KEY the same value "
                f"(it answers {status}: {said})",
                REST_S,
            )
        if status == 500:
            return FailedImage(f"the encoder at {self._place} answers {status}: {said}")
        after = headers.get("retry-after", "")
        rest_s = min(MOST_REST_S, int(after[:_MOST_DIGITS])) if after.isdecimal() else REST_S
        return self._away(f"answers {status}: {said}", rest_s)

    def _away(self, what: str, retry_after_s: int = REST_S) -> EncoderAway:
        return EncoderAway(f"the encoder at {self._place} {what}", max(REST_S, retry_after_s))


def _layers(tensors: Mapping[str, Tensor], call: _Call, channels: Mapping[str, int]) -> Mapping[str, Floats]:
    """The outputs by the names of layers; raises BadBody."""
    layers: dict[str, Floats] = {}
    for layer, name in call.outputs.items():
        tensor = tensors.get(name)
        if tensor is None or tensor.dtype != np.float32 or tensor.shape != (*call.shape, channels[layer]):
            seen = None if tensor is None else (str(tensor.dtype), tensor.shape)
            raise BadBody("malformed-body", f"the output {name} of {call.shape[0]} images is {seen}")
        layers[layer] = np.asarray(tensor, np.float32)
    return layers


def _is_unit(field: Floats) -> bool:
    """Whether all vectors of a field have unit length; those with numbers that are none have not."""
    squares = np.einsum("...d,...d->...", field, field)
    return bool((np.abs(squares - 1) <= 2 * UNIT_WITHIN).all())


def _said(content: bytes) -> str:
    """What a refusal says: the member ``error`` (KServe) or ``detail`` (RFC 9457) of its JSON, or its beginning."""
    text = content[:4096].decode(errors="replace").strip()
    try:
        told = json.loads(content)
    except (ValueError, RecursionError):
        told = None
    said = (told.get("error") or told.get("detail")) if isinstance(told, dict) else text
    return str(said or "nothing")[:_LONGEST_WORD]
