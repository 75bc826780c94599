"""What travels over HTTP as answers, field by field; `schemas.requests` has what is sent as JSON."""

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, WithJsonSchema


def rfc3339(moment: datetime) -> str:
    """A UTC time as RFC 3339 with microseconds and ``Z``."""
    return moment.strftime("%Y-%m-%dT%H:%M:%S.%fZ")


Moment = Annotated[
    datetime,
    PlainSerializer(rfc3339, return_type=str, when_used="json"),
    WithJsonSchema({"type": "string", "format": "date-time"}, mode="serialization"),
]


class Answer(BaseModel):
    """Base of every answer: what is not declared is not sent."""

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
    """How much of an image carries a label."""

    label: str
    share: float = Field(ge=0, le=1)


class ImageFacts(Answer):
    """The enrolled image, upright."""

    width: int
    height: int
    bytes: int
    format: Literal["jpeg", "png", "webp", "bmp", "tiff"]
    sha256: str


class DescriptionFacts(Answer):
    """What the map's recipe made of the image."""

    recipe: str
    sampled_descriptors: int = Field(description="Pixel descriptors that the histograms count.")
    static_share: float = Field(description="Share of cells that do not move.", ge=0, le=1)
    labels: list[LabelShare] = Field(description="Labels present, largest share first.")
    nodes: int = Field(description="Nodes of the context graph.")


class Failure(Answer):
    """Why a view is not searchable."""

    code: str
    detail: str


class ViewLinks(Answer):
    """Where to find more about a view."""

    self: str
    image: str
    thumbnail: str
    segmentation: str
    graph: str


class View(Answer):
    """One enrolled image and what was said about it."""

    id: str
    map: str
    place: str | None
    position: Position | None
    captured_at: Moment | None
    enrolled_at: Moment
    metadata: dict[str, Any]
    image: ImageFacts
    state: Literal["pending", "ready", "failed"]
    failure: Failure | None = None
    description: DescriptionFacts | None = None
    links: ViewLinks


class Enrolled(Answer):
    """One image was enrolled, or was there already."""

    view: View
    created: bool = Field(description="False when these very bytes were in the map already.")
    revision: int = Field(description="The map's revision after this.")
    job: str | None = Field(None, description="The job that describes it, when the call did not wait.")
    timing_ms: dict[str, float]


class EnrolmentError(Answer):
    """One image of several that was refused."""

    index: int = Field(description="Position among the pictures sent, from 0.")
    filename: str | None
    type: str
    title: str
    status: int
    detail: str
    errors: list["ProblemParameter"] = []


class EnrolledMany(Answer):
    """Several images were sent."""

    views: list[Enrolled]
    errors: list[EnrolmentError]
    revision: int
    timing_ms: dict[str, float]


class QueryFacts(Answer):
    """The image that was asked about."""

    id: str
    width: int
    height: int
    labels: list[LabelShare]
    static_share: float


class ChannelMatch(Answer):
    """How one channel's histogram search saw a match."""

    distance: float = Field(description="L2 between the histogram vectors.")
    rank: int | None = Field(description="Rank in this channel's search, from 1; null when outside its candidates.")


class DenseMatch(Answer):
    """Comparison of the coarse grids of embeddings."""

    similarity: float = Field(
        description="Root of the share of the query's cells that agree on one shift, 0..1: of cells that join all "
        "channels, or of a channel alone, whichever has the view stand out more."
    )
    median_similarity: float = Field(description="The median similarity of all candidates: what a wrong view gets.")
    p85_similarity: float = Field(
        description="85th percentile over all candidates: what wrong views get that look alike."
    )
    shift: tuple[int, int] = Field(description="(rows, columns) by which the view's grid moved to fit best.")
    scale: float | None = Field(
        description="How much larger the view shows the place than the query, 0.5..2; null if not compared in full."
    )


class NodePair(Answer):
    """Two nodes that correspond: same label, cosine above t, each the other's best."""

    label: str
    cosine: float
    query: tuple[float, float] = Field(description="(x, y) in fractions of the longer side.")
    view: tuple[float, float]


class GraphMatch(Answer):
    """Comparison of the context graphs."""

    similarity: float
    correspondences: int
    nodes_query: int
    nodes_view: int
    edges_agreeing: int
    pairs: list[NodePair] | None = Field(None, description="Only with explain=true.")


class VerificationMatch(Answer):
    """Geometric verification by local features."""

    inliers: int
    matches: int
    transform: list[list[float]] | None = Field(
        description="2 x 3, maps the query's positions to the view's (fractions of the longer side)."
    )
    pairs: list[tuple[tuple[float, float], tuple[float, float]]] | None = Field(
        None, description="Inlier positions in query and view; only with explain=true."
    )


class MatchLinks(Answer):
    """Images of a match."""

    image: str
    thumbnail: str
    explanation: str | None = None


class Match(Answer):
    """One view that may show the place."""

    rank: int
    view: View
    score: float = Field(ge=0, le=1)
    confidence: float = Field(description="Calibrated probability that this is the place.", ge=0, le=1)
    parts: dict[str, float] = Field(description="What each term adds; they sum to the score.")
    channels: dict[str, ChannelMatch]
    dense: DenseMatch | None
    graph: GraphMatch | None
    verification: VerificationMatch | None
    links: MatchLinks


class Estimate(Answer):
    """Where the query was probably taken, from the positions of the matches that agree."""

    position: Position
    radius_m: float
    views: list[str]


class QueryAnswer(Answer):
    """Which views of the map show the place."""

    query: QueryFacts
    map: str
    revision: int
    recipe: str = Field(description="Id of the description recipe.")
    ranking: str = Field(description="Id of the ranking.")
    searched: int
    status: Literal["matched", "ambiguous", "no_match"]
    confidence: float
    matches: list[Match]
    estimate: Estimate | None
    timing_ms: dict[str, float]


class Label(Answer):
    """One label of a map's label set."""

    index: int = Field(description="Value of its pixels in segmentation.png.")
    label: str
    mapped_to: list[str] = Field(description="The encoder's own labels that stand for it.")
    trained: bool = Field(description="Whether the encoder saw labelled pixels of it.")
    dynamic: bool
    colour: str = Field(description="#rrggbb in segmentation.png.")


class Extent(Answer):
    """The box around a map's positions."""

    minimum: Position
    maximum: Position


class MapFacts(Answer):
    """A map: its recipe, counts and size."""

    name: str
    revision: int
    views: dict[Literal["pending", "ready", "failed"], int]
    places: int
    bytes: int = Field(description="Of the pictures.")
    recipe: dict[str, Any] = Field(description="What decides descriptions; `id` names it.")
    ranking: dict[str, Any] = Field(description="How candidates are ranked; PATCH changes it. `id` names it.")
    labels: list[Label]
    vocabulary: dict[str, Any]
    extent: Extent | None
    created_at: Moment


class Maps(Answer):
    """All maps, by name."""

    maps: list[MapFacts]


class Views(Answer):
    """A page of views."""

    views: list[View]
    next: str | None = Field(description="Cursor of the next page; null on the last.")


class Place(Answer):
    """A user's own name for a spot, and its views."""

    map: str
    place: str
    views: int
    position: Position | None = Field(description="Mean of its views' positions.")
    last_enrolled_at: Moment


class Places(Answer):
    """A page of places."""

    places: list[Place]
    next: str | None


class Deleted(Answer):
    """Receipt of a deletion."""

    views: int
    images: int = Field(description="Picture files removed; one is kept while another view shows the same bytes.")
    revision: int | None


class JobProgress(Answer):
    """How far a job is: images done, of how many."""

    done: int
    total: int


class Job(Answer):
    """A piece of work in the background."""

    id: str
    kind: Literal["describe", "recipe", "vocabulary"]
    state: Literal["waiting", "running", "done", "failed", "cancelled"]
    map: str
    view: str | None
    attempts: int
    progress: JobProgress | None = Field(description="Of a job of a map, once it has begun.")
    result: dict[str, Any] | None = Field(description="What a finished job made, such as the id of the map's recipe.")
    created_at: Moment
    finished_at: Moment | None
    failure: Failure | None
    links: dict[str, str]


class Jobs(Answer):
    """A page of jobs, newest first."""

    jobs: list[Job]
    next: str | None = Field(description="Cursor of the next page; null on the last.")


class Readiness(Answer):
    """What the service can do at this moment."""

    ready: bool
    checks: dict[str, str] = Field(description="Name of each part: ok, or what is wrong with it.")


class Version(Answer):
    """What is running."""

    version: str
    encoder: str
    weights: str
    preset: str
    schema_version: str
    python: str
    libraries: dict[str, str]


class ProblemParameter(Answer):
    """One parameter that cannot be used."""

    parameter: str
    detail: str


class Problem(Answer):
    """An error, RFC 9457."""

    type: str = Field(examples=["urn:revisit:problem:picture-too-large"])
    title: str
    status: int
    detail: str
    errors: list[ProblemParameter] = []
    request_id: str
