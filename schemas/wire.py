"""Models of the answers over HTTP; `schemas.requests` has those of the requests."""

from typing import Any, Literal

from pydantic import Field, JsonValue

from .wire_calibration import (
    CalibrationReport as CalibrationReport,
    HeldOutFigures as HeldOutFigures,
    MeasuredRate as MeasuredRate,
    PrecisionThreshold as PrecisionThreshold,
)
from .wire_changes import (
    Change as Change,
    Changes as Changes,
    Spot as Spot,
)
from .wire_deletions import (
    Deleted as Deleted,
    HoldingSnapshot as HoldingSnapshot,
)
from .wire_health import (
    HealthCode as HealthCode,
    HealthFinding as HealthFinding,
    MapHealth as MapHealth,
    ScoreFall as ScoreFall,
)
from .wire_inbox import (
    DismissedPlace as DismissedPlace,
    NamedPlace as NamedPlace,
    Proposal as Proposal,
    Proposals as Proposals,
    UnknownPlace as UnknownPlace,
    UnknownPlaces as UnknownPlaces,
)
from .wire_query import (
    ChannelMatch as ChannelMatch,
    DecisionFacts as DecisionFacts,
    DenseMatch as DenseMatch,
    Difference as Difference,
    DriveFacts as DriveFacts,
    DrivePlace as DrivePlace,
    Estimate as Estimate,
    GraphMatch as GraphMatch,
    MapAnswer as MapAnswer,
    Match as Match,
    MatchLinks as MatchLinks,
    NodePair as NodePair,
    PlaceProbability as PlaceProbability,
    QueryAnswer as QueryAnswer,
    QueryFacts as QueryFacts,
    Reason as Reason,
    Rival as Rival,
    ScoredId as ScoredId,
    VerificationMatch as VerificationMatch,
)
from .wire_readiness import (
    MapReadiness as MapReadiness,
    Readiness as Readiness,
)
from .wire_shadow import (
    Job as Job,
    JobProgress as JobProgress,
    Jobs as Jobs,
    Shadow as Shadow,
    ShadowAnswer as ShadowAnswer,
    ShadowQuery as ShadowQuery,
    ShadowSide as ShadowSide,
    ShadowTable as ShadowTable,
    ShadowTotals as ShadowTotals,
)
from .wire_snapshots import (
    RestoredMap as RestoredMap,
    Snapshot as Snapshot,
    Snapshots as Snapshots,
)
from .wire_views import (
    Answer as Answer,
    DescriptionFacts as DescriptionFacts,
    Failure as Failure,
    ImageFacts as ImageFacts,
    LabelShare as LabelShare,
    Moment as Moment,
    Position as Position,
    View as View,
    ViewLinks as ViewLinks,
    rfc3339 as rfc3339,
)


class EnrolmentWarning(Answer):
    """Something about an image that was enrolled."""

    code: Literal["poor-picture", "duplicate", "look-alike"] = Field(
        description="poor-picture: it is dark, overexposed, covered or blurred, or shows mostly things that move; "
        "duplicate: nearly the same image is in the map; look-alike: the map takes it for another place. What moves "
        "and the last two are told of views described in the call."
    )
    detail: str
    view: str | None = Field(None, description="Id of the view that it is a duplicate of, or looks like.")


class Enrolled(Answer):
    """The result of enrolling one image."""

    view: View
    created: bool = Field(description="False when the same bytes were in the map already.")
    revision: int = Field(description="The map's revision after this enrolment.")
    job: str | None = Field(None, description="The job that describes the view, while it is pending.")
    warnings: list[EnrolmentWarning] = Field(
        default_factory=list,
        description="What may keep the view from being recognised, or others; it is enrolled all the same.",
    )
    timing_ms: dict[str, float]


class EnrolmentError(Answer):
    """A refused image among several."""

    index: int = Field(description="Position among the images sent, from 0.")
    filename: str | None
    type: str
    title: str
    status: int
    detail: str
    errors: list["ProblemParameter"] = Field(default_factory=list)


class EnrolledMany(Answer):
    """The result of enrolling several images."""

    views: list[Enrolled]
    errors: list[EnrolmentError]
    revision: int
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
    """Bounding box of a map's positions. Across the meridian of 180° `minimum.lon` is the larger (RFC 7946, 5.2)."""

    minimum: Position
    maximum: Position


class ExpectedDecisions(Answer):
    """What may be expected of answers with the status matched."""

    precision: float | None = Field(
        description="Share of them that are right; null when no held-out query of a calibration was matched."
    )
    matched_share: float = Field(description="Share of right first answers that are matched.")
    queries: int | None = Field(
        None,
        description="Labelled queries of this map that both were measured on, held out; null: other maps' queries.",
    )


class MapDecision(Answer):
    """What verdicts on queries of a map rest on."""

    source: Literal["cohort", "own-views", "calibration"] = Field(
        description="cohort: mostly what wrong answers get in other maps, while few views are compared; own-views: "
        "mostly what they get in this one; calibration: that, by a curve adjusted to labelled queries of this map."
    )
    views_compared: int = Field(
        description="Views compared with the map as it is: once it rests all that are `ready`, at most 2,000; none of "
        "an only one."
    )
    expected: ExpectedDecisions
    updated_at: Moment | None = Field(description="Of the calibration, or of the latest comparison of its views.")


class PresetDifference(Answer):
    """A parameter whose value in a map is another than in its preset."""

    parameter: str = Field(examples=["ranking.candidates"])
    value: JsonValue = Field(description="In the map; null: it has none.")
    preset: JsonValue = Field(description="In the preset; null: it has none.")


class MapFacts(Answer):
    """A map: its recipe, counts and size."""

    name: str
    revision: int
    views: dict[Literal["pending", "ready", "failed"], int]
    places: int
    bytes: int = Field(description="Of all images that are kept.")
    recipe: dict[str, Any] = Field(description="Description recipe, with its `id`.")
    ranking: dict[str, Any] = Field(description="Ranking config, with its `id`; PATCH changes it.")
    preset_differences: list[PresetDifference] = Field(
        default_factory=list,
        description="Where parameters and ranking are not those of the map's preset in this version, by its user's "
        "wish or as it was made by an earlier one: what POST /maps/{map}/recipe that names the preset would change. "
        "Without `precision` and `same_place_m`, which stay; empty for a map of another encoder.",
    )
    decision: MapDecision
    keep_queries: int = Field(0, description="How many queries that matched nothing are kept at most.")
    keep_matches: int = Field(0, description="How many that matched a view but look unlike it are kept at most.")
    refuse_poor: bool = Field(False, description="Whether poor images are refused, unless a request says otherwise.")
    keep_images: bool = Field(True, description="Whether images stay once their views are described.")
    shadow: str | None = Field(None, description="Id of the job of its shadow: GET /maps/{map}/shadow; null: none.")
    blur: list[str] = Field(default_factory=list, description="What is covered in an image before it is stored.")
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


class DroppedLabel(Answer):
    """A label that would be dynamic."""

    label: str
    share: float = Field(description="Of the area of all views.", ge=0, le=1)
    views: int = Field(description="That show it.")


class DroppedView(Answer):
    """A view, and how much of it would be left out at most."""

    view: View
    share: float = Field(ge=0, le=1)


class DynamicPreview(Answer):
    """What would be left out of a map's views if other labels were dynamic; shares are upper bounds."""

    map: str
    views: int = Field(description="That are described.")
    before: float = Field(description="Mean share left out by the present labels.", ge=0, le=1)
    after: float = Field(description="Mean share left out by these labels.", ge=0, le=1)
    nothing_left: int = Field(description="Views that nothing would be left of: describing them would fail.")
    labels: list[DroppedLabel]
    most: list[DroppedView] = Field(description="Views that would lose most, most first.")


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


class Version(Answer):
    """Versions of the running service and its parts."""

    version: str
    encoder: str
    weights: str
    terms: str = Field("", description="Terms of use of the encoder's weights.")
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
    errors: list[ProblemParameter] = Field(default_factory=list)
    request_id: str
