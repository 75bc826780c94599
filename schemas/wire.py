"""Models of the answers over HTTP; `schemas.requests` has those of the requests."""

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
    format: Literal["jpeg", "png", "webp", "bmp", "tiff"]
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
    image: ImageFacts
    state: Literal["pending", "ready", "failed"]
    failure: Failure | None = None
    description: DescriptionFacts | None = None
    links: ViewLinks


class Enrolled(Answer):
    """The result of enrolling one image."""

    view: View
    created: bool = Field(description="False when the same bytes were in the map already.")
    revision: int = Field(description="The map's revision after this enrolment.")
    job: str | None = Field(None, description="The job that describes the view, while it is pending.")
    timing_ms: dict[str, float]


class EnrolmentError(Answer):
    """A refused image among several."""

    index: int = Field(description="Position among the images sent, from 0.")
    filename: str | None
    type: str
    title: str
    status: int
    detail: str
    errors: list["ProblemParameter"] = []


class EnrolledMany(Answer):
    """The result of enrolling several images."""

    views: list[Enrolled]
    errors: list[EnrolmentError]
    revision: int
    timing_ms: dict[str, float]


class QueryFacts(Answer):
    """The query image."""

    id: str
    width: int
    height: int
    labels: list[LabelShare]
    static_share: float


class ChannelMatch(Answer):
    """A match in the histogram search of one channel."""

    distance: float = Field(description="L2 between the histogram vectors.")
    rank: int | None = Field(description="Rank in this channel's search, from 1; null when outside its candidates.")


class DenseMatch(Answer):
    """Comparison of the dense cells."""

    similarity: float = Field(
        description="Square root of the share of the query's cells that agree on one shift, 0..1; the larger of all "
        "channels together and detail alone."
    )
    median_similarity: float = Field(description="Median over all candidates: what a wrong view gets.")
    p85_similarity: float = Field(
        description="85th percentile over all candidates: what wrong views get that look most like the query."
    )
    shift: tuple[int, int] = Field(description="(rows, columns) by which the view's grid is moved against the query's.")
    scale: float | None = Field(
        description="Size of the place in the view relative to the query, 0.5..2; null unless compared in full."
    )


class NodePair(Answer):
    """Two corresponding nodes: same label, cosine above t, each the other's best."""

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
    """URLs of the images of a match."""

    image: str
    thumbnail: str
    explanation: str | None = None


class Match(Answer):
    """One view that may show the place."""

    rank: int
    view: View
    score: float = Field(ge=0, le=1)
    confidence: float = Field(description="Calibrated probability that this is the place.", ge=0, le=1)
    parts: dict[str, float] = Field(description="What each term adds to the score; the parts sum to it.")
    channels: dict[str, ChannelMatch]
    dense: DenseMatch | None
    graph: GraphMatch | None
    verification: VerificationMatch | None
    links: MatchLinks


class Estimate(Answer):
    """Estimated position of the query, from the positions of matches that agree."""

    position: Position
    radius_m: float | None = Field(
        description="How far off it may be: spread of the views, or of one view the usual distance to its neighbours; "
        "null when that is not known."
    )
    views: list[str]


class Difference(Answer):
    """A region of the query image that speaks for the first match or for its rival."""

    centre: tuple[float, float] = Field(description="(x, y) in fractions of the longer side.")
    extent: tuple[float, float] = Field(description="(width, height) in fractions of the longer side.")
    strength: float = Field(description="Above 0: speaks for the first match; below 0: for the rival.")


class Rival(Answer):
    """The best view of another place than the first one's."""

    view: View
    score: float
    differs: list[Difference] | None = Field(
        None, description="Where the first match and this one differ most, largest first; only with explain=true."
    )


class Reason(Answer):
    """Why the status is what it is."""

    code: Literal["sure", "look-alike", "weak", "few-views", "poor-picture", "empty"] = Field(
        description="sure: one place stands out; look-alike: another place is nearly as good; weak: nothing stands out "
        "from what wrong places get in this map; few-views: too little is enrolled to tell; poor-picture: the image "
        "shows too little; empty: there was nothing to search."
    )
    detail: str = Field(description="What was seen.")
    remedy: str = Field(description="What to do.")
    rival: Rival | None = Field(None, description="With look-alike.")


class ScoredId(Answer):
    """A view by its id, and its score."""

    id: str
    score: float


class PlaceProbability(Answer):
    """A place that the query may show: views with one name, near each other, or alike by the map's own comparison."""

    place: str | None = Field(description="Name of its best view's place.")
    position: Position | None = Field(description="Of its best view.")
    probability: float = Field(ge=0, le=1)
    views: list[ScoredId] = Field(description="Best first.")


class DecisionFacts(Answer):
    """What the verdict was made from."""

    precision: float = Field(description="Share of matched answers that must be right.")
    threshold: float = Field(description="From this confidence on: matched.")
    features: dict[str, float] = Field(
        description="What the probability was computed from. gap: log(1 + lead over the best view of another place, in "
        "gaps of wrong answers); level: log of the score over what wrong answers get here, at most 0."
    )
    wrong_score: float = Field(description="What wrong answers score in this map.")
    wrong_gap: float = Field(description="By how much wrong answers lead over the next place in this map.")
    views_compared: int = Field(description="Views of the map that these two were measured with.")


class QueryAnswer(Answer):
    """The answer to a query: places and views of the map that it may show, best first."""

    query: QueryFacts
    map: str
    revision: int
    recipe: str = Field(description="Id of the description recipe.")
    ranking: str = Field(description="Id of the ranking.")
    searched: int
    pending: int = Field(description="Views of the map that were acknowledged and are not described yet.")
    status: Literal["matched", "ambiguous", "no_match"]
    confidence: float = Field(description="Probability that the first place is right.", ge=0, le=1)
    reason: Reason
    places: list[PlaceProbability] = Field(description="Best first; with `nowhere` their probabilities sum to 1.")
    nowhere: float = Field(description="Probability that the image shows none of the places.", ge=0, le=1)
    decision: DecisionFacts
    matches: list[Match]
    estimate: Estimate | None
    timing_ms: dict[str, float]


class Label(Answer):
    """One label of a map's label set."""

    index: int = Field(description="Value of its pixels in segmentation.png.")
    label: str
    mapped_to: list[str] = Field(description="The encoder's own labels used for it.")
    trained: bool = Field(description="Whether the encoder was trained on labelled pixels of it.")
    dynamic: bool
    colour: str = Field(description="#rrggbb in segmentation.png.")


class Extent(Answer):
    """Bounding box of a map's positions."""

    minimum: Position
    maximum: Position


class ExpectedDecisions(Answer):
    """What may be expected of answers with the status matched."""

    precision: float = Field(description="Share of them that are right.")
    matched_share: float = Field(description="Share of right first answers that are matched.")


class MapDecision(Answer):
    """What verdicts on queries of a map rest on."""

    source: Literal["cohort", "own-views"] = Field(
        description="cohort: mostly what wrong answers get in other maps, while few views are compared; own-views: "
        "mostly what they get in this one."
    )
    views_compared: int
    expected: ExpectedDecisions
    updated_at: Moment | None = Field(description="Of the latest comparison of its views.")


class MapFacts(Answer):
    """A map: its recipe, counts and size."""

    name: str
    revision: int
    views: dict[Literal["pending", "ready", "failed"], int]
    places: int
    bytes: int = Field(description="Of all images.")
    recipe: dict[str, Any] = Field(description="Description recipe, with its `id`.")
    ranking: dict[str, Any] = Field(description="Ranking config, with its `id`; PATCH changes it.")
    decision: MapDecision
    labels: list[Label]
    vocabulary: dict[str, Any]
    extent: Extent | None
    created_at: Moment


class Maps(Answer):
    """All maps, sorted by name."""

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
    images: int = Field(description="Image files removed; a file is kept while another view has the same bytes.")
    revision: int | None


class JobProgress(Answer):
    """Progress of a job, in images."""

    done: int
    total: int


class Job(Answer):
    """A background job."""

    id: str
    kind: Literal["describe", "recipe", "vocabulary"]
    state: Literal["waiting", "running", "done", "failed", "cancelled"]
    map: str
    view: str | None
    attempts: int
    progress: JobProgress | None = Field(description="Of a job of a map that has started.")
    result: dict[str, Any] | None = Field(description="Of a finished job, such as the id of the map's recipe.")
    created_at: Moment
    finished_at: Moment | None
    failure: Failure | None
    links: dict[str, str]


class Jobs(Answer):
    """A page of jobs, newest first."""

    jobs: list[Job]
    next: str | None = Field(description="Cursor of the next page; null on the last.")


class Readiness(Answer):
    """Whether the service can answer, and the state of each part."""

    ready: bool
    checks: dict[str, str] = Field(description="Name of each part: ok, or what is wrong with it.")


class Version(Answer):
    """Versions of the running service and its parts."""

    version: str
    encoder: str
    weights: str
    preset: str
    schema_version: str
    python: str
    libraries: dict[str, str]


class ProblemParameter(Answer):
    """An invalid parameter."""

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
