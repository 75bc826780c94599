"""Snapshots: what a file holds, as JSON, and what is made of it."""

from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

from pydantic import AwareDatetime, Base64Bytes, BaseModel, ConfigDict, Field

from schemas.blur import MOST_WORDS
from schemas.inbox import MOST_KEPT
from schemas.recipe import DescriptionRecipe, RankingConfig
from schemas.values import MAP_NAME

FORMAT: Final = "revisit-snapshot"
VERSION: Final = 2

Digest = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Count = Annotated[int, Field(ge=0, le=2**62)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Line(BaseModel):
    """Base: unknown fields are refused, since they would be lost."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SnapshotFacts(Line):
    """The first part of a snapshot: what it is.

    Parameters
    ----------
    id : str
        Of the job that made it.
    row_bytes : int
        Bytes of the parts besides the images.
    ranking, calibration, keep_images, keep_queries, keep_matches, refuse_poor, blur
        As the map has them; calibration is the JSON of its own one, None for the shipped one. Kept queries stay behind.
    """

    format: Literal["revisit-snapshot"] = FORMAT
    version: Literal[1, 2] = VERSION
    id: str = Field(pattern="^[0-9a-f-]{36}$")
    map: str = Field(pattern=MAP_NAME)
    map_created_at: AwareDatetime
    created_at: AwareDatetime
    revision: Count
    views: Count
    image_bytes: Count
    row_bytes: Count
    description: DescriptionRecipe
    ranking: RankingConfig
    calibration: str | None
    keep_images: bool = True
    keep_queries: Annotated[int, Field(ge=0, le=MOST_KEPT)] = 0
    keep_matches: Annotated[int, Field(ge=0, le=MOST_KEPT)] = 0
    refuse_poor: bool = False
    blur: Annotated[tuple[Annotated[str, Field(min_length=1, max_length=100)], ...], Field(max_length=MOST_WORDS)] = ()


class SnapshotDescription(Line):
    """A description by the map's recipe; bodies as `worker.storage.packing` makes them; in version 1, Base64."""

    descriptor_count: Count
    static_share: Finite
    nodes: Count
    label_shares: Base64Bytes
    vectors: Base64Bytes
    appearances: Base64Bytes
    cells: Base64Bytes
    keypoints: Base64Bytes | None


class SnapshotSizes(Line):
    """A description whose bodies, of so many bytes, stand one after another in a part of their own."""

    descriptor_count: Count
    static_share: Finite
    nodes: Count
    label_shares: Count
    vectors: Count
    appearances: Count
    cells: Count
    keypoints: Count | None


class _View(Line):
    """A view without its description; `number` orders views by enrolment and names them within the snapshot.

    The snapshot has its image, unless the map keeps none and the view is described.
    """

    number: Count
    id: str = Field(pattern="^[0-9a-f-]{36}$")
    place: str | None = Field(max_length=1000)
    x: Finite | None
    y: Finite | None
    z: Finite | None
    lat: Finite | None
    lon: Finite | None
    alt: Finite | None
    heading: Finite | None
    captured_at: AwareDatetime | None
    metadata: dict[str, Any]
    filename: str | None = Field(None, max_length=1000)
    enrolled_at: AwareDatetime
    elapsed_us: Count
    sha256: Digest
    sent_sha256: Digest | None = None
    width: int = Field(ge=1, le=2**31 - 1)
    height: int = Field(ge=1, le=2**31 - 1)
    byte_count: int = Field(ge=1, le=2**62)
    format: Literal["png", "jpeg", "webp", "bmp", "tiff", "heic"]
    state: Literal["pending", "ready", "failed"]
    failure_code: str | None
    failure_detail: str | None


class SnapshotLine(_View):
    """A view as a line of version 2; with a description only when it is ready."""

    description: SnapshotSizes | None


class SnapshotView(_View):
    """A view with its description, when it is ready: a line of version 1."""

    description: SnapshotDescription | None


class SnapshotComparison(Line):
    """What a view found in its own map: see `schemas.comparisons.Comparison`."""

    number: Count
    among: Count
    others: Count
    level: Finite | None
    gap: Finite | None
    same_spot: tuple[Count, ...]
    made_at: AwareDatetime
    rival: Count | None = None
    own: Finite | None = None
    breadth: Finite | None = None


class SnapshotPart(Line):
    """A line of the manifest."""

    name: str
    sha256: Digest
    size: Count


@dataclass(frozen=True)
class SnapshotRecord:
    """A snapshot that the service keeps, and the bytes of its file."""

    facts: SnapshotFacts
    size: int


@dataclass(frozen=True)
class RestoredMap:
    """A map that was made from a snapshot.

    Parameters
    ----------
    pending : int
        Views that are described from their images, since the snapshot had no description of them.
    new_ids : bool
        Whether its views got new ids, because the service had one of theirs already.
    """

    map: str
    snapshot: str
    views: int
    pending: int
    revision: int
    new_ids: bool
