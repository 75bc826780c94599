"""Parameters of requests without a JSON body: one model per route."""

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Annotated, Any, Literal, get_args

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, WithJsonSchema

from app.http.validation import Parameters
from schemas import values
from schemas.errors import ParameterError
from schemas.records import Filters, JobKind, Position, ViewAttributes
from schemas.where import condition
from schemas.wire import HealthCode

METADATA_FILTER = "metadata.KEY"
"""Name of the metadata filters in the OpenAPI document; KEY stands for any key."""

_METADATA = "metadata."

MOST_METADATA = 64
"""Metadata filters of one request, as many as a condition has comparisons: no database takes any number of them."""

_TRUE = ("1", "true", "yes", "on", "t", "y")
"""What pydantic reads as true."""


def as_text(**schema: object) -> WithJsonSchema:
    """OpenAPI schema of a value that is written as text."""
    return WithJsonSchema({"type": "string", **schema})


def _condition(text: str) -> str:
    """Check a condition on views."""
    condition(text)
    return text


MapName = Annotated[str, Field(pattern=values.MAP_NAME, description="Name of the map.", examples=["campus"])]
PlaceName = Annotated[str, BeforeValidator(values.place_name), Field(min_length=1, max_length=200)]
KnownPlace = Annotated[str, BeforeValidator(values.plain_text), Field(min_length=1, max_length=200)]
"""The name of a place to look for: names that were given before they were checked are found too."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
Metres = Annotated[Finite, Field(ge=-values.FARTHEST_M, le=values.FARTHEST_M)]
Time = Annotated[
    datetime, BeforeValidator(values.moment), as_text(format="date-time", examples=["2026-03-01T09:30:00Z"])
]
Metadata = Annotated[
    dict[str, Any], BeforeValidator(values.metadata), as_text(examples=['{"camera": "front", "floor": 2}'])
]


class NoParameters(Parameters):
    """Parameters of routes that take none."""


def _contradicting_positions(given: Mapping[str, Any]) -> list[ParameterError]:
    """Mistakes of incomplete positions and of two frames at once; judged by the names alone."""
    metric = [name for name in ("x", "y", "z") if name in given]
    geographic = [name for name in ("lat", "lon", "alt") if name in given]
    if metric and geographic:
        detail = f"metres ({', '.join(metric)}) and degrees ({', '.join(geographic)}) cannot both be given"
        return [ParameterError(metric[0], detail)]
    return [
        ParameterError(missing, f"is missing: {', '.join(names)} alone is half a position")
        for names, needed in ((metric, ("x", "y")), (geographic, ("lat", "lon")))
        if names
        for missing in needed
        if missing not in names
    ]


class PositionParameters(Parameters):
    """Where an image was taken: metres in the map's frame, or degrees."""

    x: Metres | None = Field(None, description="Metres in the map's frame, right-handed; with y.")
    y: Metres | None = Field(None, description="Metres; with x.")
    z: Metres | None = Field(None, description="Metres; only with x and y.")
    lat: Annotated[Finite, Field(ge=-90, le=90)] | None = Field(None, description="Degrees, WGS 84; with lon.")
    lon: Annotated[Finite, Field(ge=-180, le=180)] | None = Field(None, description="Degrees, WGS 84; with lat.")
    alt: Metres | None = Field(None, description="Metres above the ellipsoid; only with lat and lon.")
    heading: Annotated[Finite, Field(ge=0, le=360), AfterValidator(values.whole_turn)] | None = Field(
        None, description="Degrees clockwise from north, or from +y; 360 is 0."
    )

    @classmethod
    def contradictions(cls, given: Mapping[str, Any]) -> list[ParameterError]:
        """Mistakes of incomplete positions and of two frames at once."""
        return _contradicting_positions(given)

    def position(self) -> Position:
        """The position as a record."""
        return Position(self.x, self.y, self.z, self.lat, self.lon, self.alt, self.heading)


class EnrollParameters(PositionParameters):
    """Parameters of `POST /enroll`."""

    map: MapName = "default"
    place: PlaceName | None = Field(None, description="Your own name for the place; many views may share it.")
    captured_at: Time | None = Field(None, description="When the image was taken, RFC 3339 with zone.")
    metadata: Metadata = Field(
        default_factory=dict, description="A JSON object that is kept with the view; at most 16 KB, 8 levels."
    )
    filename: Annotated[str, AfterValidator(values.file_name)] | None = Field(
        None,
        description="File name to show, for an image that is the body, or instead of the name of its part. Folders and "
        "control characters are left out, and it is cut to 255 characters.",
    )
    refuse_poor: bool | None = Field(
        None,
        description="Refuse an image that is dark, overexposed, covered or blurred, shows mostly things that move or "
        "is nearly in the map already; with `wait=false` the last two become `failed` views, once they are described. "
        "false: enrol it, and say so in `warnings`. Default: the map's.",
    )
    exif: bool = Field(False, description="Take position, heading and time from the image's EXIF where none is given.")
    wait: bool = Field(True, description="Answer once the view is searchable; false: once it is durable.")

    def attributes(self) -> ViewAttributes:
        """The view's attributes as a record."""
        return ViewAttributes(self.place, self.position(), self.captured_at, self.metadata)


class FilterParameters(Parameters):
    """Filters of views, for queries and lists; with any number of ``metadata.KEY=VALUE``."""

    near: Annotated[
        tuple[float, float, float], BeforeValidator(values.near), as_text(examples=["12.5,3.0,20"])
    ] | None = Field(
        None,
        description="x,y,radius or lat,lon,radius, as the map's positions are; the radius in metres: views within it.",
    )  # fmt: skip
    frame: Literal["map", "geo"] | None = Field(
        None,
        description="Frame of `near`: map for metres, geo for degrees. Default: that of the map's positions; a map "
        "with both needs to be told.",
    )
    after: Time | None = Field(None, description="Views captured at this time or later.")
    before: Time | None = Field(None, description="Views captured at this time or earlier.")
    place: KnownPlace | None = Field(None, description="Views of this place.")
    where: Annotated[str, AfterValidator(_condition)] | None = Field(
        None,
        description="Views of which this condition holds, as JSON: fields, operators, $and, $or, $not.",
        examples=['{"place": {"$prefix": "hall/"}, "metadata.floor": {"$gte": 2}}'],
    )
    exclude_last: Annotated[
        int | timedelta, BeforeValidator(values.exclude_last), as_text(examples=["10", "30s"])
    ] | None = Field(
        None, description="Without the newest N views, or without those of the last seconds (30s): for loop closure."
    )  # fmt: skip
    exclude: Annotated[tuple[str, ...], BeforeValidator(values.identifiers), as_text()] = Field(
        (), description="Ids of views to leave out, with commas between."
    )
    metadata: Annotated[dict[str, str], as_text()] = Field(
        default_factory=dict,
        validation_alias=METADATA_FILTER,
        description="Views whose metadata has this value under KEY, compared as text; several keys may be given.",
    )

    @classmethod
    def gathered(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """Join all ``metadata.KEY=VALUE`` into one field; undo the lists that FastAPI makes for fields of tuples."""
        flat = {name: text[-1] if isinstance(text, list) else text for name, text in given.items()}
        keys = [name for name in flat if name.startswith(_METADATA) and name != _METADATA]
        filters = {name.removeprefix(_METADATA): flat.pop(name) for name in keys}
        return {**flat, METADATA_FILTER: filters} if filters else flat

    @classmethod
    def contradictions(cls, given: Mapping[str, Any]) -> list[ParameterError]:
        """Mistakes: degrees out of range, `frame` without `near`, a time span that ends before it begins."""
        found = []
        if (count := len(given.get(METADATA_FILTER, ()))) > MOST_METADATA:
            found.append(ParameterError(METADATA_FILTER, f"{count} keys; at most {MOST_METADATA} are taken"))
        if given.get("frame") == "geo" and "near" in given:
            try:
                latitude, longitude, _ = values.near(given["near"])
            except ValueError:
                pass  # reported by the field's own validator
            else:
                if abs(latitude) > 90 or abs(longitude) > 180:
                    found.append(ParameterError("near", "needs a latitude within ±90 and a longitude within ±180"))
        elif "frame" in given and "near" not in given:
            found.append(ParameterError("frame", "is of use only with near"))
        try:
            if values.moment(given["after"]) > values.moment(given["before"]):
                found.append(ParameterError("after", "is later than before: no view can fit"))
        except (KeyError, ValueError):
            pass
        return found

    def filters(self) -> Filters:
        """The filters as a record."""
        return Filters(
            near=self.near,
            geographic=None if self.frame is None else self.frame == "geo",
            after=self.after,
            before=self.before,
            place=self.place,
            metadata=self.metadata,
            where=None if self.where is None else condition(self.where),
            exclude_last=self.exclude_last,
            exclude=self.exclude,
        )


class ListViews(FilterParameters):
    """Parameters of `GET /views`."""

    map: MapName | None = None
    state: Literal["pending", "ready", "failed"] | None = Field(None, description="Only views in this state.")
    sort: Literal["enrolled_at", "-enrolled_at"] = Field("enrolled_at", description="- for newest first.")
    words: Annotated[str, BeforeValidator(values.plain_text)] | None = Field(
        None,
        max_length=1000,
        description="Labels of the map, with commas between: its described views by how much of them these are, most "
        "first, those without any left out. pole+fence: views where both are, the more the better.",
        examples=["fence,tree"],
    )
    cursor: str | None = Field(None, min_length=1, max_length=500, description="`next` of the page before.")
    limit: int = Field(50, ge=1, le=500, description="Views a page.")

    @classmethod
    def contradictions(cls, given: Mapping[str, Any]) -> list[ParameterError]:
        """Mistakes: `words` without a map, or with an order or a state, which they imply."""
        found = super().contradictions(given)
        if "words" in given:
            if "map" not in given:
                found.append(ParameterError("words", "needs map: each map has labels of its own"))
            found += [
                ParameterError(name, "cannot be given with words: described views come, most of it first")
                for name in ("sort", "state")
                if name in given
            ]
        return found


def _leaves_out(text: object) -> bool:
    """Whether `exclude_last` leaves out any view: 0 leaves out none, 0s the newest; True where it cannot be read."""
    try:
        return values.exclude_last(text) != 0
    except ValueError:
        return True


class DeleteViews(FilterParameters):
    """Parameters of `DELETE /views`: a map, and a filter or all=true, so that a typing mistake empties nothing."""

    map: MapName
    all: bool = Field(False, description="All views of the map, instead of filters.")

    @classmethod
    def contradictions(cls, given: Mapping[str, Any]) -> list[ParameterError]:
        """Mistakes: neither a filter nor all=true, or both."""
        found = super().contradictions(given)
        everything = str(given.get("all", "")).lower() in _TRUE
        filtered = any(given.get(name) for name in given if name not in ("map", "all", "frame", "exclude_last"))
        filtered = filtered or _leaves_out(given.get("exclude_last", "0"))
        if everything and filtered:
            found.append(ParameterError("all", "contradicts the filters: give one or the other"))
        elif not everything and not filtered:
            found.append(ParameterError("all", "give at least one filter, or all=true to delete every view of the map"))
        return found


def _job_kinds(text: str) -> str:
    """Check kinds of jobs with commas between them, each once."""
    known, named = get_args(JobKind), text.split(",")
    if not set(named) <= set(known) or len(set(named)) < len(named):
        raise ValueError(f"needs some of {', '.join(known)}, each once, with commas between them")
    return text


class ListJobs(Parameters):
    """Parameters of `GET /jobs`."""

    map: MapName | None = None
    kind: Annotated[str, AfterValidator(_job_kinds)] | None = Field(
        None,
        examples=["recipe,import"],
        description=f"Only jobs of these kinds, with commas between: {', '.join(get_args(JobKind))}. "
        "Each view that is enrolled has a job of the kind describe, those of an import too.",
    )
    state: Literal["waiting", "running", "done", "failed", "cancelled"] | None = Field(
        None, description="Only jobs in this state."
    )
    cursor: str | None = Field(None, min_length=1, max_length=500, description="`next` of the page before.")
    limit: int = Field(50, ge=1, le=500, description="Jobs a page.")

    @property
    def kinds(self) -> tuple[JobKind, ...]:
        """The kinds that are named; none: all."""
        return tuple(kind for kind in get_args(JobKind) if self.kind and kind in self.kind.split(","))


class RestoreParameters(Parameters):
    """Parameters of `POST /restore`."""

    as_: MapName | None = Field(None, alias="as", description="Name of the new map. Default: the name that it had.")


class ListPlaces(Parameters):
    """Parameters of `GET /places`."""

    map: MapName | None = None
    cursor: str | None = Field(None, min_length=1, max_length=500, description="`next` of the page before.")
    limit: int = Field(50, ge=1, le=500, description="Places a page.")


class HealthParameters(Parameters):
    """Parameters of `GET /maps/{map}/health`."""

    code: HealthCode | None = Field(None, description="Only findings of this kind.")
    limit: int = Field(20, ge=1, le=500, description="Findings of each kind at most.")


class UnknownParameters(Parameters):
    """Parameters of `GET /maps/{map}/unknown`."""

    limit: int = Field(20, ge=1, le=500, description="Places at most.")


class ProposalParameters(UnknownParameters):
    """Parameters of `GET /maps/{map}/proposals`."""


class ThumbnailParameters(Parameters):
    """Parameters of `GET /views/{id}/thumbnail`."""

    size: int = Field(256, ge=16, le=1024, description="Longer side in pixels.")


class SegmentationParameters(Parameters):
    """Parameters of `GET /views/{id}/segmentation.png`."""

    overlay: bool = Field(False, description="Blend the colours over the photo, with dynamic labels in grey.")
    legend: bool = Field(
        False, description="With overlay: a key below the photo. Without it the drawing is as large as the photo."
    )

    @classmethod
    def contradictions(cls, given: Mapping[str, Any]) -> list[ParameterError]:
        """Mistakes: a legend without overlay, whose values are read by programs."""
        wanted = [str(given.get(name, "")).lower() in _TRUE for name in ("overlay", "legend")]
        return [ParameterError("legend", "is of use only with overlay=true")] if wanted == [False, True] else []


class GraphParameters(Parameters):
    """Parameters of `GET /views/{id}/graph.png`."""

    legend: bool = Field(False, description="A key below the photo. Without it the drawing is as large as the photo.")


class AttributesDocument(PositionParameters):
    """The attributes of a view after the merge patch of `PATCH /views/{id}`."""

    model_config = ConfigDict(strict=True)

    place: PlaceName | None = None
    captured_at: Annotated[datetime, BeforeValidator(values.moment)] | None = None
    metadata: Annotated[dict[str, Any], BeforeValidator(values.metadata_object)] = Field(default_factory=dict)

    def attributes(self) -> ViewAttributes:
        """The attributes as a record."""
        return ViewAttributes(self.place, self.position(), self.captured_at, self.metadata)
