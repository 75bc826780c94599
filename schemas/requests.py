"""Models of the JSON bodies of requests."""

from typing import Annotated, Any, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from schemas.blur import MOST_WORDS
from schemas.inbox import MOST_KEPT
from schemas.shadow import MOST_QUERIES
from schemas.wire_views import Position

Label = Annotated[str, Field(min_length=1, max_length=100)]


class Body(BaseModel):
    """Base of all bodies: undeclared fields are errors, and so are numbers that are none."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class PutMap(Body):
    """Recipe of a map; fields left out take the service's defaults.

    Errors name the labels, presets or parameters that exist.
    """

    labels: list[Label] | None = Field(None, min_length=1, max_length=255, description="Label set, in order.")
    dynamic: list[Label] | None = Field(
        None, max_length=255, description="Labels of things that move; their cells are left out of descriptions."
    )
    preset: Annotated[str, Field(min_length=1, max_length=64)] | None = Field(
        None, description="Named set of parameters, such as `default` or `paper`.", examples=["default"]
    )
    parameters: dict[str, Any] | None = Field(
        None, description="Description parameters that differ from the preset's.", examples=[{"local_features": 500}]
    )
    ranking: dict[str, Any] | None = Field(
        None, description="Ranking parameters that differ from the preset's.", examples=[{"candidates": 100}]
    )


class PostRecipe(PutMap):
    """Recipe that a map's views are described by anew; fields left out keep the map's values.

    A `preset` that is named, the map's own too, brings its parameters and ranking as this version has them; of the
    ranking `precision` and `same_place_m` stay. Errors name the labels, presets or parameters that exist.
    """

    shadow: Annotated[int, Field(ge=1, le=MOST_QUERIES)] | None = Field(
        None,
        description="Do not change over: answer so many of the map's last kept queries by both recipes, with views of "
        "the map where they are too few, and wait to be told (`POST /maps/{map}/shadow/switch`, or `DELETE "
        "/maps/{map}/shadow`).",
        examples=[100],
    )


class PatchMap(Body):
    """Changes of a map that take effect at once: its ranking, what is kept, which images are refused."""

    ranking: dict[str, Any] | None = Field(
        None, description="Ranking parameters to change; the others stay.", examples=[{"candidates": 100}]
    )
    keep_queries: Annotated[int, Field(ge=0, le=MOST_KEPT)] | None = Field(
        None,
        description="How many queries that matched nothing are kept at most, with a small image of each, for "
        "`GET /maps/{map}/unknown`; the oldest are dropped. 0 deletes those that are kept.",
    )
    keep_matches: Annotated[int, Field(ge=0, le=MOST_KEPT)] | None = Field(
        None,
        description="How many queries are kept at most that matched a view although they look unlike it, with a small "
        "image of each, for `GET /maps/{map}/proposals`; the oldest are dropped. 0 deletes those that are kept.",
    )
    refuse_poor: bool | None = Field(
        None,
        description="Refuse to enrol images that are dark, overexposed, covered or blurred, show mostly things that "
        "move or are nearly in the map already, unless a request says otherwise.",
    )
    keep_images: bool | None = Field(
        None,
        description="false removes all images of described views, for good, and each later one once it is described. "
        "The views are found as before; they are shown without an image and cannot be described by another recipe.",
    )
    blur: Annotated[list[Label], Field(max_length=MOST_WORDS)] | None = Field(
        None,
        description="What is covered in each image before it is stored, as far as the segmentation finds it: "
        "`people`, `vehicles`, or labels; [] for nothing. Words can be added while the map has no views.",
        examples=[["people", "vehicles"]],
    )


def _whole_turn(given: Any) -> Any:
    """A position with a heading of 360 degrees as 0, as enrolments take it; anything else as it is."""
    return {**given, "heading": 0} if isinstance(given, dict) and given.get("heading") == 360 else given


class PostUnknown(Body):
    """The name of an unknown place, and where it is."""

    place: Annotated[str, Field(min_length=1, max_length=200)] = Field(description="Your own name for the place.")
    position: Annotated[Position | None, BeforeValidator(_whole_turn)] = None


class PostProposal(Body):
    """How much of a proposal is taken."""

    views: Annotated[int, Field(ge=1, le=10)] = Field(
        3, description="How many of its images become views at most, spread evenly over time."
    )
    unconfirmed: bool = Field(False, description="Take queries too that no other one agrees with on the place.")


class _Labelled(Body):
    block: Annotated[str, Field(min_length=1, max_length=200)] | None = Field(
        None, description="Queries of one block, such as a drive, are held out together; null: runs of the list."
    )


class ObservedAnswer(_Labelled):
    """What an answer of the map was decided from, and whether its first place was right."""

    features: dict[str, Annotated[float, Field(ge=-100, le=100)]] = Field(
        description="`decision.features` of the answer; empty for an answer without matches.",
        examples=[{"gap": 1.9, "level": 0.0, "breadth": 1.2, "own": 0.4, "either": 1.7}],
    )
    right: bool = Field(description="Whether the first place was right.")
    known: bool = Field(True, description="Whether the map has the place; false: none of its places is right.")

    @model_validator(mode="after")
    def _right_where_known(self) -> Self:
        if self.right and not self.known:
            raise ValueError("an answer cannot be right when the map lacks the place")
        return self


class LabelPosition(Body):
    """Where the right place is: metres in the map's frame, or degrees."""

    x: float | None = None
    y: float | None = None
    lat: Annotated[float, Field(ge=-90, le=90)] | None = None
    lon: Annotated[float, Field(ge=-180, le=180)] | None = None

    @model_validator(mode="after")
    def _one_point(self) -> Self:
        given = {name for name, value in self if value is not None}
        if given not in ({"x", "y"}, {"lat", "lon"}):
            raise ValueError("a position is x and y, or lat and lon")
        return self


class LabelledView(_Labelled):
    """An enrolled view, to query the map with while it is left out, and the right place: its name or its position."""

    view: Annotated[str, Field(min_length=1, max_length=100)] = Field(description="Id of a described view of the map.")
    place: Annotated[str, Field(min_length=1, max_length=200)] | None = Field(
        None, description="Name of the right place; null: none of the map's places."
    )
    position: LabelPosition | None = None

    @model_validator(mode="after")
    def _one_label(self) -> Self:
        if ("place" in self.model_fields_set) == (self.position is not None):
            raise ValueError("either place (null: none of the map's places) or position is needed")
        return self


class PostCalibration(Body):
    """Labelled queries of a map, in the order in which they were taken."""

    observed: list[ObservedAnswer] = Field(
        default_factory=list, max_length=5000, description="Answers that the map gave to queries."
    )
    queries: list[LabelledView] = Field(
        default_factory=list, max_length=200, description="Enrolled views; each takes as long as a query."
    )
    recipe: str | None = Field(None, description="`recipe` of the observed answers: refused when the map has another.")
    ranking: str | None = Field(None, description="`ranking` of the observed answers, likewise.")
    within: Annotated[float, Field(ge=0, le=100_000)] = Field(
        0.0, description="A first place at most this far from a position is right, metres; at least `same_place_m`."
    )
    dry_run: bool = Field(False, description="Report, and keep nothing.")
