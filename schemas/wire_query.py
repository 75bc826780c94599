"""Models of the answer to a query over HTTP."""

from typing import Literal

from pydantic import Field

from .wire_changes import Changes
from .wire_views import Answer, LabelShare, Position, View


class QueryFacts(Answer):
    """The query image."""

    id: str
    width: int
    height: int
    labels: list[LabelShare]
    static_share: float
    fixed_share: float = Field(
        0.0,
        description="Share that was left out because it is the same in every view of the map: a bonnet, black bars.",
        ge=0,
        le=1,
    )


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
        description="sure: one place stands out (with `consistent` and another status: too few images agree so far); "
        "look-alike: another place is nearly as good; weak: nothing stands out from what wrong places get in this map, "
        "or not enough; few-views: too little is enrolled to tell; poor-picture: the image shows too little; empty: "
        "there was nothing to search."
    )
    detail: str = Field(description="What was seen.")
    remedy: str = Field(description="What to do.")
    rival: Rival | None = Field(None, description="With look-alike.")


class ScoredId(Answer):
    """A view by its id, and its score."""

    id: str
    score: float


class PlaceProbability(Answer):
    """A place that the query may show: views with one name, near each other or else alike to the map."""

    map: str = Field(description="Its map.")
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
        "gaps of wrong answers); level: log of the score over what wrong answers get here, at most 0; breadth: log(1 "
        "+ over how much of the image that lead holds, in breadths of wrong answers); own: how near the score comes to "
        "what views of one place get of each other here, 0..0.5, less where keypoints of others agree too; either: "
        "breadth and own together, sqrt(breadth^2 + (3 own)^2)."
    )
    wrong_score: float = Field(description="What wrong answers score in this map.")
    wrong_gap: float = Field(description="By how much wrong answers lead over the next place in this map.")
    wrong_breadth: float = Field(0.0, description="Over how much of the image leads of wrong answers hold in this map.")
    own_score: float = Field(0.0, description="What sure views of one place get of each other in this map.")
    views_compared: int = Field(description="Views of the map that these were measured with.")


class DrivePlace(Answer):
    """A place, and how likely the images of a drive make it."""

    place: str | None
    position: Position | None
    probability: float = Field(ge=0, le=1)
    views: list[str] = Field(description="Ids of its views, likeliest first.")


class DriveFacts(Answer):
    """What the images of a drive say together."""

    images: int = Field(description="Images that count, this one included; 1: the drive is new, or was forgotten.")
    posterior: list[DrivePlace] = Field(
        description="Places of the candidates of this image, likeliest first; those below .001 are left out."
    )
    nowhere: float = Field(description="Probability that the image shows none of these places.", ge=0, le=1)
    single_frame_status: Literal["matched", "ambiguous", "no_match"] = Field(
        description="The verdict on this image alone."
    )
    agreeing: int = Field(
        0,
        description="Images in a row, up to this one, that are matched one by one, each at most five views from the "
        "one before, by order of enrolment.",
    )


class MapAnswer(Answer):
    """One of several maps that were searched."""

    map: str
    revision: int
    recipe: str = Field(description="Id of the description recipe.")
    ranking: str = Field(description="Id of the ranking.")
    searched: int
    pending: int
    probability: float = Field(description="That the image shows one of its places in `places`.", ge=0, le=1)


class QueryAnswer(Answer):
    """The answer to a query: places and views that it may show, best first."""

    query: QueryFacts
    map: str = Field(description="That was searched; with `maps`: the one of the first place.")
    revision: int = Field(description="Of this map.")
    recipe: str = Field(description="Id of its description recipe.")
    ranking: str = Field(description="Id of its ranking.")
    searched: int = Field(description="Views searched, of all maps.")
    pending: int = Field(description="Views acknowledged but not described when the search began, of all maps.")
    status: Literal["matched", "ambiguous", "no_match"]
    confidence: float = Field(description="Probability that the first place is right.", ge=0, le=1)
    reason: Reason
    places: list[PlaceProbability] = Field(description="Best first; with `nowhere` their probabilities sum to 1.")
    nowhere: float = Field(description="Probability that the image shows none of the places.", ge=0, le=1)
    decision: DecisionFacts
    maps: list[MapAnswer] | None = Field(None, description="With `maps`: each of them.")
    drive: DriveFacts | None = Field(None, description="With `drive`: what its images say together.")
    matches: list[Match]
    estimate: Estimate | None
    changes: Changes | None = Field(None, description="With `changes=true`: what changed since the first match.")
    timing_ms: dict[str, float]
