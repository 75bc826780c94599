"""The shapes of CompreFace's recognition service (REST API 1.2): places as subjects, images as their examples.

For apps that speak to CompreFace and change nothing but the address. The service recognises places, so there is one
result an image, and its box is the whole image.
"""

import asyncio
import base64
import binascii
from collections.abc import Sequence

from pydantic import Field
from starlette.requests import Request

from app.http.body import json_object, take
from app.http.parameters import KnownPlace, PlaceName
from app.http.validation import Parameters
from schemas.errors import InvalidParameters, ParameterError
from schemas.wire import PlaceProbability, QueryAnswer, View
from schemas.wire_views import Answer

FILE_PART = "file"
"""Name of the part, or of the field of a JSON body in base64, that is the image."""

LARGEST = 1 << 31
"""Bytes; REVISIT_MAX_BODY_MB has refused what is larger before."""


class Detection(Parameters):
    """What CompreFace's clients send along about faces; taken, and of no use here."""

    det_prob_threshold: float | None = Field(None, ge=0, le=1, description="Of no use here: the box is the image.")
    face_plugins: str | None = Field(None, max_length=200, description="Of no use here.")
    status: bool = Field(False, description="Name the software and how long it took.")
    limit: int = Field(0, ge=0, description="Of no use here: there is one result an image.")
    detect_faces: bool = Field(True, description="Of no use here.")


class Recognition(Detection):
    """Parameters of a recognition."""

    prediction_count: int = Field(1, ge=0, le=100, description="Subjects at most; 0: all that the answer has.")


class Example(Parameters):
    """Parameters of a new example."""

    subject: PlaceName = Field(description="Name of the place.")
    det_prob_threshold: float | None = Field(None, ge=0, le=1, description="Of no use here.")


class NamedPlace(Parameters):
    """The name of a place in a JSON body."""

    subject: PlaceName


class Examples(Parameters):
    """Parameters of a list of examples."""

    page: int = Field(0, ge=0, le=1_000_000, description="Number of the page, from 0.")
    size: int = Field(20, ge=1, le=10_000, description="Examples a page.")
    subject: KnownPlace | None = Field(None, description="Only of this place.")


class ExamplesOf(Parameters):
    """Parameters of a deletion of examples."""

    subject: KnownPlace | None = Field(None, description="Only of this place; without it all of the map.")


class Subject(Answer):
    """A place by its name."""

    subject: str


class Subjects(Answer):
    """All places of a map."""

    subjects: list[str]


class Renamed(Answer):
    """Whether there was anything to rename."""

    updated: bool


class Count(Answer):
    """How many were deleted."""

    deleted: int


class ExampleFacts(Answer):
    """An example: a view of a place."""

    image_id: str
    subject: str = Field(description="Name of the place; empty where the view has none.")


class ExamplePage(Answer):
    """A page of examples."""

    faces: list[ExampleFacts]
    page_number: int
    page_size: int
    total_pages: int
    total_elements: int


class Box(Answer):
    """Where in the image: all of it."""

    probability: float
    x_min: int
    y_min: int
    x_max: int
    y_max: int


class Similar(Answer):
    """A place, and how probable it is."""

    subject: str
    similarity: float = Field(ge=0, le=1, description="Probability that the image shows this place.")


class Verdict(Answer):
    """The service's own verdict, which a threshold on `similarity` cannot replace."""

    status: str = Field(description="matched, ambiguous or no_match.")
    reason: str = Field(description="Why, as `reason.code` of `POST /query`.")


class Recognised(Verdict):
    """What an image shows."""

    box: Box
    subjects: list[Similar]
    execution_time: dict[str, float] | None = Field(None, description="Milliseconds; with status=true.")


class Verified(Verdict):
    """Whether an image shows the place of an example."""

    box: Box
    subject: str
    similarity: float = Field(ge=0, le=1)
    execution_time: dict[str, float] | None = Field(None, description="Milliseconds; with status=true.")


class Recognitions(Answer):
    """The one result of an image."""

    result: list[Recognised]
    plugins_versions: dict[str, str] | None = Field(None, description="With status=true.")


class Verifications(Answer):
    """The one result of an image."""

    result: list[Verified]
    plugins_versions: dict[str, str] | None = Field(None, description="With status=true.")


async def one_image(request: Request) -> tuple[str | None, bytes]:
    """File name and bytes of the image of a request: multipart part ``file``, or base64 as ``file`` of a JSON body.

    Raises
    ------
    BadBody, BadImage, BodyTooLarge
        As `app.http.body.take`.
    InvalidParameters
        There are several images or other parts, or the base64 is none.
    """
    in_url = set(request.query_params)
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        sent = await take(request, FILE_PART)
        errors = list(sent.errors)
        errors += [ParameterError(name, "belongs into the URL") for name, _ in sent.parameters if name not in in_url]
        if len(sent.images) > 1:
            errors.append(ParameterError(FILE_PART, f"{len(sent.images)} images; send one"))
        if errors:
            raise InvalidParameters(errors)
        return sent.images[0]
    encoded = (await json_object(request, LARGEST)).get(FILE_PART)
    try:
        data = await asyncio.to_thread(base64.b64decode, encoded if isinstance(encoded, str) else "", validate=True)
    except (binascii.Error, ValueError):
        data = b""
    if not data:
        raise InvalidParameters.of(FILE_PART, "needs an image in base64")
    return None, data


def recognised(answer: QueryAnswer, wanted: Recognition, version: str) -> Recognitions:
    """The answer to a query, as CompreFace shapes it."""
    named = [Similar(subject=one.place, similarity=one.probability) for one in answer.places if one.place is not None]
    result = Recognised(
        box=_box(answer),
        subjects=named[: wanted.prediction_count or None],
        status=answer.status,
        reason=answer.reason.code,
        execution_time=dict(answer.timing_ms) if wanted.status else None,
    )
    return Recognitions(result=[result], plugins_versions={"revisit": version} if wanted.status else None)


def verified(answer: QueryAnswer, example: View, wanted: Detection, version: str) -> Verifications:
    """The answer to a query, as a comparison with the place of one example."""
    result = Verified(
        box=_box(answer),
        subject=example.place or "",
        similarity=_probability(answer.places, example),
        status=answer.status,
        reason=answer.reason.code,
        execution_time=dict(answer.timing_ms) if wanted.status else None,
    )
    return Verifications(result=[result], plugins_versions={"revisit": version} if wanted.status else None)


def example(view: View) -> ExampleFacts:
    """A view, as CompreFace shapes it."""
    return ExampleFacts(image_id=view.id, subject=view.place or "")


def _box(answer: QueryAnswer) -> Box:
    return Box(probability=1.0, x_min=0, y_min=0, x_max=answer.query.width, y_max=answer.query.height)


def _probability(places: Sequence[PlaceProbability], example: View) -> float:
    """Of the place that an example shows; 0 where it is not among those of the answer."""
    for place in places:
        same = place.place == example.place if example.place is not None else False
        if same or example.id in [view.id for view in place.views]:
            return place.probability
    return 0.0
