"""What may be said beside an image, and asked of a list: one model per request."""

from collections.abc import Mapping
from datetime import datetime, timedelta
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field, WithJsonSchema

from app.http import values
from app.http.validation import Parameters
from schemas.errors import ParameterError
from schemas.records import Filters, Position, ViewAttributes

METADATA_FILTER = "metadata.KEY"
"""How the document names the filters by metadata, of which there may be several."""

_METADATA = "metadata."


def _text(**schema: object) -> WithJsonSchema:
    """OpenAPI of a value that is text on the wire."""
    return WithJsonSchema({"type": "string", **schema})


MapName = Annotated[str, Field(pattern=values.MAP_NAME, description="Name of the map.", examples=["campus"])]
PlaceName = Annotated[str, BeforeValidator(values.plain_text), Field(min_length=1, max_length=200)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Time = Annotated[datetime, BeforeValidator(values.moment), _text(format="date-time", examples=["2026-03-01T09:30:00Z"])]
Metadata = Annotated[
    dict[str, Any], BeforeValidator(values.metadata), _text(examples=['{"camera": "front", "floor": 2}'])
]


class NoParameters(Parameters):
    """Of addresses that take none."""


def _contradicting_positions(given: Mapping[str, Any]) -> list[ParameterError]:
    """Half a position, or two frames; looks at which parameters are there, not at their values."""
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

    x: Finite | None = Field(None, description="Metres in the map's frame, right-handed; with y.")
    y: Finite | None = Field(None, description="Metres; with x.")
    z: Finite | None = Field(None, description="Metres; only with x and y.")
    lat: Annotated[Finite, Field(ge=-90, le=90)] | None = Field(None, description="Degrees, WGS 84; with lon.")
    lon: Annotated[Finite, Field(ge=-180, le=180)] | None = Field(None, description="Degrees, WGS 84; with lat.")
    alt: Finite | None = Field(None, description="Metres above the ellipsoid; only with lat and lon.")
    heading: Annotated[Finite, Field(ge=0, lt=360)] | None = Field(
        None, description="Degrees clockwise from north, or from +y; below 360."
    )

    @classmethod
    def contradictions(cls, given: Mapping[str, Any]) -> list[ParameterError]:
        """Half a position, or two frames."""
        return _contradicting_positions(given)

    def position(self) -> Position:
        """The position as a record."""
        return Position(self.x, self.y, self.z, self.lat, self.lon, self.alt, self.heading)


class EnrollParameters(PositionParameters):
    """Of `POST /enroll`."""

    map: MapName = "default"
    place: PlaceName | None = Field(None, description="Your own name for the spot; many views may share it.")
    captured_at: Time | None = Field(None, description="When the image was taken, RFC 3339 with zone.")
    metadata: Metadata = Field(
        default_factory=dict, description="A JSON object that is kept with the view; at most 16 KB, 8 levels."
    )
    wait: bool = Field(True, description="Answer when the view is searchable; false: when it is durable.")

    def attributes(self) -> ViewAttributes:
        """What the user said about the view."""
        return ViewAttributes(self.place, self.position(), self.captured_at, self.metadata)


class FilterParameters(Parameters):
    """Which views a query or a list is about; together with ``metadata.KEY=VALUE``."""

    near: Annotated[
        tuple[float, float, float], BeforeValidator(values.near), _text(examples=["12.5,3.0,20"])
    ] | None = Field(
        None, description="x,y,radius in metres: views within the radius; with frame=geo lat,lon,radius."
    )  # fmt: skip
    frame: Literal["map", "geo"] = Field("map", description="What `near` is given in.")
    after: Time | None = Field(None, description="Views captured at this time or later.")
    before: Time | None = Field(None, description="Views captured at this time or earlier.")
    place: PlaceName | None = Field(None, description="Views of this place.")
    exclude_last: Annotated[
        int | timedelta, BeforeValidator(values.exclude_last), _text(examples=["10", "30s"])
    ] | None = Field(
        None, description="Not the newest N views, or not those of the last seconds (30s): for loop closure."
    )  # fmt: skip
    exclude: Annotated[tuple[str, ...], BeforeValidator(values.identifiers), _text()] = Field(
        (), description="Ids with commas between."
    )
    metadata: Annotated[dict[str, str], _text()] = Field(
        default_factory=dict,
        validation_alias=METADATA_FILTER,
        description="Views whose metadata has this value under KEY, as text; may be given for several keys.",
    )

    @classmethod
    def gathered(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """``metadata.KEY=VALUE`` of all keys as one field, and text where FastAPI makes a list for a tuple."""
        flat = {name: text[-1] if isinstance(text, list) else text for name, text in given.items()}
        keys = [name for name in flat if name.startswith(_METADATA) and name != _METADATA]
        filters = {name.removeprefix(_METADATA): flat.pop(name) for name in keys}
        return {**flat, METADATA_FILTER: filters} if filters else flat

    @classmethod
    def contradictions(cls, given: Mapping[str, Any]) -> list[ParameterError]:
        """A centre that is no place on Earth, and a time span that ends before it begins."""
        found = []
        if given.get("frame") == "geo" and "near" in given:
            try:
                latitude, longitude, _ = values.near(given["near"])
            except ValueError:
                pass  # its own validator says so
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
            geographic=self.frame == "geo",
            after=self.after,
            before=self.before,
            place=self.place,
            metadata=self.metadata,
            exclude_last=self.exclude_last,
            exclude=self.exclude,
        )


class QueryParameters(FilterParameters):
    """Of `POST /query`."""

    map: MapName = "default"
    top: int = Field(5, ge=1, le=100, description="How many matches at most.")
    candidates: int | None = Field(
        None,
        ge=0,
        le=500,
        description="How many of each channel are re-ranked; 0: histograms alone. Default: the map's.",
    )
    explain: bool = Field(False, description="Say and draw which regions and local features matched.")


class ListViews(FilterParameters):
    """Of `GET /views`."""

    map: MapName | None = None
    state: Literal["pending", "ready", "failed"] | None = Field(None, description="Only views in this state.")
    sort: Literal["enrolled_at", "-enrolled_at"] = Field("enrolled_at", description="- for newest first.")
    cursor: str | None = Field(None, min_length=1, max_length=500, description="`next` of the page before.")
    limit: int = Field(50, ge=1, le=500, description="Views a page.")


class DeleteViews(FilterParameters):
    """Of `DELETE /views`: a map and at least one filter, so that a typing mistake empties nothing."""

    map: MapName
    all: bool = Field(False, description="All views of the map, instead of filters.")

    @classmethod
    def contradictions(cls, given: Mapping[str, Any]) -> list[ParameterError]:
        """Neither a filter nor all=true, or both."""
        found = super().contradictions(given)
        everything = str(given.get("all", "")).lower() in ("1", "true", "yes", "on", "t", "y")
        filtered = any(given.get(name) for name in given if name not in ("map", "all", "frame"))
        if everything and filtered:
            found.append(ParameterError("all", "contradicts the filters: give one or the other"))
        elif not everything and not filtered:
            found.append(ParameterError("all", "give at least one filter, or all=true to delete every view of the map"))
        return found


class ListJobs(Parameters):
    """Of `GET /jobs`."""

    map: MapName | None = None
    kind: Literal["describe", "recipe", "vocabulary"] | None = Field(None, description="Only jobs of this kind.")
    state: Literal["waiting", "running", "done", "failed", "cancelled"] | None = Field(
        None, description="Only jobs in this state."
    )
    cursor: str | None = Field(None, min_length=1, max_length=500, description="`next` of the page before.")
    limit: int = Field(50, ge=1, le=500, description="Jobs a page.")


class ListPlaces(Parameters):
    """Of `GET /places`."""

    map: MapName | None = None
    cursor: str | None = Field(None, min_length=1, max_length=500, description="`next` of the page before.")
    limit: int = Field(50, ge=1, le=500, description="Places a page.")


class ThumbnailParameters(Parameters):
    """Of `GET /views/{id}/thumbnail`."""

    size: int = Field(256, ge=16, le=1024, description="Pixels of the longer side.")


class SegmentationParameters(Parameters):
    """Of `GET /views/{id}/segmentation.png`."""

    overlay: bool = Field(False, description="Blend the colours over the photo and grey what moves.")


class ExplanationParameters(Parameters):
    """Of `GET /queries/{id}/explanation.png`."""

    view: Annotated[str, Field(pattern=r"^[A-Za-z0-9-]{1,64}$")] | None = Field(
        None, description="Which match to explain; the best one when not given."
    )


class AttributesDocument(PositionParameters):
    """What was said about a view, after `PATCH /views/{id}` was merged into it."""

    model_config = ConfigDict(strict=True)

    place: PlaceName | None = None
    captured_at: Annotated[datetime, BeforeValidator(values.moment)] | None = None
    metadata: Annotated[dict[str, Any], BeforeValidator(values.metadata)] = Field(default_factory=dict)

    def attributes(self) -> ViewAttributes:
        """As a record."""
        return ViewAttributes(self.place, self.position(), self.captured_at, self.metadata)
