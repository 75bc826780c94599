"""Parameters of queries: one model per route."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from app.http.parameters import FilterParameters, MapName, as_text
from app.http.validation import Parameters
from schemas import values
from schemas.errors import ParameterError

DriveName = Annotated[str, Field(pattern=values.MAP_NAME, description="Name of a drive.", examples=["robot-7"])]

OF_DRIVES = ("drive_timeout", "consistent")
"""What says how a drive is followed."""


class QueryParameters(FilterParameters):
    """Parameters of `POST /query`."""

    map: MapName = "default"
    maps: Annotated[tuple[str, ...], BeforeValidator(values.map_names), as_text(examples=["floor1,floor2"])] = Field(
        (), description="Names of several maps, with commas between, instead of `map`: one verdict over all of them."
    )
    top: int = Field(5, ge=1, le=100, description="How many matches at most.")
    candidates: int | None = Field(
        None,
        ge=0,
        le=500,
        description="Candidates of each channel to re-rank; 0: rank by histograms alone. Default: the map's.",
    )
    precision: float | None = Field(
        None,
        ge=0.5,
        le=0.999,
        description="Share of answers with the status matched that must be right: the higher, the more often the "
        "status is ambiguous. Default: the map's, 0.97 unless it was changed.",
    )
    zoom: float = Field(
        1,
        ge=1 / values.LARGEST_ZOOM,
        le=values.LARGEST_ZOOM,
        description="How many times as large the image's camera shows things as that of the map: tan(b/2) / tan(a/2), "
        "where a is its field of view along the image's longer side and b that of the map's. The image is compared as "
        "the map's camera would have taken it, which positions in the answer refer to, and is kept neither as an "
        "unknown place nor as a proposal.",
        examples=[1.4],
    )
    roll: float = Field(
        0,
        ge=-180,
        le=180,
        description="Degrees by which the camera was turned clockwise around its line of sight, looking along it. The "
        "image is compared as a level camera would have taken it; the rest as for `zoom`.",
        examples=[-12.5],
    )
    drive: DriveName | None = Field(
        None,
        description="Name of a drive that this image is the next one of: the evidence of its images adds up.",
    )
    drive_timeout: float = Field(
        60,
        ge=0.1,
        le=86400,
        description="Seconds of silence after which the drive begins anew; only with drive.",
    )
    consistent: int | None = Field(
        None,
        ge=2,
        le=100,
        description="matched is said only where so many images of the drive in a row, this one the last, are matched "
        "one by one and come back to one stretch of the map; only with drive. Default: their evidence adds up.",
    )
    explain: bool = Field(
        False,
        description="List the regions and local features that matched, and keep what the explanation is drawn from.",
    )
    changes: bool = Field(
        False, description="Say what is gone, new or moved since the first match was taken; explains the query too."
    )

    @classmethod
    def contradictions(cls, given: Mapping[str, Any]) -> list[ParameterError]:
        """Mistakes: `maps` beside `map`, or beside a drive, which runs in one; what is said of no drive."""
        found = super().contradictions(given)
        found += [
            ParameterError("maps", f"cannot be given with {name}")
            for name in ("map", "drive")
            if {"maps", name} <= given.keys()
        ]
        found += [
            ParameterError(name, "is of use only with drive")
            for name in OF_DRIVES
            if name in given and "drive" not in given
        ]
        return found

    def searched(self) -> tuple[str, ...]:
        """Names of the maps to search."""
        return self.maps or (self.map,)


class LocalizeParameters(Parameters):
    """Parameters of `POST /localize/geopose`."""

    map: MapName = "default"
    precision: float | None = Field(
        None, ge=0.5, le=0.999, description="Share of poses that must be of the right place. Default: the map's."
    )
