"""Models of views, which other answers over HTTP contain."""

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, WithJsonSchema


def rfc3339(moment: datetime) -> str:
    """A UTC time as RFC 3339 with microseconds and ``Z``."""
    # Not strftime, which writes the year 208 with three digits on Linux.
    return moment.replace(tzinfo=None).isoformat(timespec="microseconds") + "Z"


Moment = Annotated[
    datetime,
    PlainSerializer(rfc3339, return_type=str, when_used="json"),
    WithJsonSchema({"type": "string", "format": "date-time"}, mode="serialization"),
]


class Answer(BaseModel):
    """Base of all answers: undeclared fields are errors."""

    model_config = ConfigDict(extra="forbid")


class Position(Answer):
    """Where an image was taken: metres in the map's frame, or WGS 84 degrees; never both."""

    x: float | None = Field(None, description="Metres, right-handed, in the map's frame.")
    y: float | None = None
    z: float | None = None
    lat: float | None = Field(None, description="Degrees, WGS 84.", ge=-90, le=90)
    lon: float | None = Field(None, ge=-180, le=180)
    alt: float | None = Field(None, description="Metres above the ellipsoid.")
    heading: float | None = Field(None, description="Degrees clockwise from north, or from +y.", ge=0, lt=360)


class LabelShare(Answer):
    """Share of an image's cells with a label."""

    label: str
    share: float = Field(ge=0, le=1)


class ImageFacts(Answer):
    """The enrolled image; width and height after turning it upright."""

    width: int
    height: int
    bytes: int
    format: Literal["jpeg", "png", "webp", "bmp", "tiff", "heic"]
    sha256: str


class DescriptionFacts(Answer):
    """Summary of the image's description by the map's recipe."""

    recipe: str
    sampled_descriptors: int = Field(description="Pixel descriptors that the histograms count.")
    static_share: float = Field(description="Share of cells that are static.", ge=0, le=1)
    labels: list[LabelShare] = Field(description="Labels present, largest share first.")
    nodes: int = Field(description="Nodes of the context graph.")


class Failure(Answer):
    """Why a view is not searchable."""

    code: str
    detail: str


class ViewLinks(Answer):
    """URLs of a view and its images."""

    self: str
    image: str
    thumbnail: str
    segmentation: str
    graph: str


class View(Answer):
    """One enrolled image and its attributes."""

    id: str
    map: str
    place: str | None
    position: Position | None
    captured_at: Moment | None
    enrolled_at: Moment
    metadata: dict[str, Any]
    filename: str | None = Field(None, description="The file name that the image was sent with, without folders.")
    image: ImageFacts
    state: Literal["pending", "ready", "failed"]
    failure: Failure | None = None
    description: DescriptionFacts | None = None
    links: ViewLinks
