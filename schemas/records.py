"""Records that store, index and encoder return: frozen, without I/O."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from schemas.description import Floats
from schemas.image import ImageFacts
from schemas.recipe import DescriptionRecipe, MapRecipe, RankingConfig
from schemas.where import Predicate

Sequence64 = npt.NDArray[np.int64]

JobState = Literal["waiting", "running", "done", "failed", "cancelled"]
JobKind = Literal["describe", "recipe", "shadow", "vocabulary", "snapshot", "import"]
ViewState = Literal["pending", "ready", "failed"]


@dataclass(frozen=True)
class Meaning:
    """How an encoder understands a label.

    Parameters
    ----------
    label : str
        As the user wrote it.
    mapped_to : tuple of str
        The encoder's own labels used for it; (label,) when the encoder has the label itself.
    trained : bool
        Whether the encoder was trained on labelled pixels of it.
    """

    label: str
    mapped_to: tuple[str, ...]
    trained: bool


@dataclass(frozen=True)
class Position:
    """Metres (x, y, z) in the map's frame or WGS 84 (lat, lon in degrees, alt in metres); all None: not given.

    `heading` is in degrees, clockwise from north or from +y.
    """

    x: float | None = None
    y: float | None = None
    z: float | None = None
    lat: float | None = None
    lon: float | None = None
    alt: float | None = None
    heading: float | None = None


@dataclass(frozen=True)
class ViewAttributes:
    """Attributes that the user gives to a view; `filename` is the name its image was sent with, without folders."""

    place: str | None = None
    position: Position = Position()
    captured_at: datetime | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)
    filename: str | None = None


@dataclass(frozen=True)
class Covered:
    """What was blurred in an image before it was stored, and the SHA-256 of what was sent."""

    words: tuple[str, ...]
    sent_sha256: str


@dataclass(frozen=True)
class MapRecord:
    """A map in the store; `calibration` is JSON of `worker.method.own_calibration`, None for the shipped one."""

    name: str
    revision: int
    description: DescriptionRecipe
    ranking: RankingConfig
    created_at: datetime
    calibration: str | None = None
    keep_queries: int = 0  # at most, of those that matched nothing
    refuse_poor: bool = False  # dark, blurred, showing mostly what moves, or adding nothing
    keep_matches: int = 0  # queries kept at most that matched a view although they look unlike it
    shadow: str | None = None  # id of the job of its shadow
    keep_images: bool = True  # False: an image is removed once its view is described
    blur: tuple[str, ...] = ()  # words of what is covered in an image before it is stored
    following: str | None = None  # id of the description recipe that it is changing to; of a shadow's
    number: int = 0  # never used twice: a map deleted and restored has its name and `created_at`, and another number

    @property
    def recipe(self) -> MapRecipe:
        """Description recipe and ranking config together."""
        return MapRecipe(description=self.description, ranking=self.ranking)


@dataclass(frozen=True)
class MapCounts:
    """Size of a map: views by state, places, bytes of images, and the bounding box of positions (all None without)."""

    views: Mapping[str, int]
    places: int
    image_bytes: int
    lowest: Position
    highest: Position


@dataclass(frozen=True, eq=False)
class DescriptionRecord:
    """Summary of a description, shown in every answer."""

    recipe: str
    descriptor_count: int
    static_share: float
    label_shares: Floats
    nodes: int


class Failure(NamedTuple):
    """Why a view or a job failed: a code, which is that of an error or ``damaged``, and what happened, in words."""

    code: str
    detail: str


@dataclass(frozen=True)
class ViewRecord:
    """A view in the store.

    Parameters
    ----------
    seq : int
        Sequence number, ascending with every enrolment in the store; the view's id in indexes.
    """

    id: str
    seq: int
    map: str
    attributes: ViewAttributes
    enrolled_at: datetime
    image: ImageFacts
    state: ViewState
    failure: Failure | None
    description: DescriptionRecord | None


class PlaceRecord(NamedTuple):
    """A place of a map.

    Parameters
    ----------
    map, place : str
        Names of the map and of the place.
    views : int
        Number of its views.
    position : Position
        Mean position of those that have one.
    last_enrolled_at : datetime
        Of the newest view.
    """

    map: str
    place: str
    views: int
    position: Position
    last_enrolled_at: datetime


@dataclass(frozen=True)
class JobProgress:
    """Progress of a job: `done` of `total` images."""

    done: int
    total: int


@dataclass(frozen=True)
class JobRecord:
    """A durable background job.

    Parameters
    ----------
    kind : str
        ``describe``: describe one view; ``recipe``: describe all views of a map by another recipe; ``shadow``: describe
        them so beside the present recipe, and compare what both answer; ``vocabulary``: train a vocabulary on a map's
        views, then describe them by it; ``import``: enrol the images of a recording.
    view_id : str or None
        Of a describe job.
    progress : JobProgress or None
        None for a describe job.
    result : mapping or None
        Of a finished job, such as the recipe's id; of an import from its beginning.
    failure : Failure or None
    """

    id: str
    kind: JobKind
    state: JobState
    map: str
    view_id: str | None
    attempts: int
    progress: JobProgress | None
    result: Mapping[str, Any] | None
    created_at: datetime
    finished_at: datetime | None
    failure: Failure | None


@dataclass(frozen=True)
class Claim:
    """A describe job claimed by a worker, until it ends or its worker gives no more signs of life.

    Parameters
    ----------
    token : str
        Identifies the claim: finishing with an outdated token raises LeaseLost.
    refuse_poor : bool
        Whether the view is to fail where its description shows that the image is poor.
    """

    job_id: str
    token: str
    view: ViewRecord
    recipe: DescriptionRecipe
    attempts: int
    refuse_poor: bool = False


@dataclass(frozen=True)
class WorkerRecord:
    """A process that describes images, by the encoder that it names; `beats` counts its signs of life."""

    name: str
    kind: str
    host: str
    pid: int
    beats: int
    encoder: str | None = None


@dataclass(frozen=True)
class MapClaim:
    """A job of a map claimed by a worker."""

    job_id: str
    kind: JobKind
    token: str
    map: str


@dataclass(frozen=True)
class Submitted:
    """A durably stored view; `created` is False when the same bytes were in the map already."""

    view: ViewRecord
    job_id: str | None
    created: bool
    revision: int


@dataclass(frozen=True)
class Changes:
    """Changes to a map's searchable views since a revision.

    Parameters
    ----------
    revision : int
        The map's revision after these changes.
    recipe : str
        Id of the map's description recipe at that revision; an index of another recipe is rebuilt.
    seqs : int64 of shape (n,)
        Views described since, ascending.
    vectors : float32 of shape (n, dimensions)
        Their histogram vectors, the channels concatenated in the recipe's order.
    gone : int64 of shape (m,)
        Views deleted since.
    """

    revision: int
    recipe: str
    seqs: Sequence64
    vectors: Floats
    gone: Sequence64


@dataclass(frozen=True)
class Filters:
    """Selects views for a search or a listing; empty fields do not restrict.

    Parameters
    ----------
    near : (float, float, float) or None
        (x, y, radius in metres) or (lat, lon, radius in metres).
    geographic : bool or None
        Whether `near` is in degrees; None: in the frame of the positions that the map has.
    after, before : datetime or None
        Bounds of `captured_at`, both inclusive.
    where : Predicate or None
    exclude_last : int or timedelta or None
        Leave out the newest N views, or those enrolled within this time of the newest one.
    exclude : tuple of str
        Ids of views to leave out.
    """

    near: tuple[float, float, float] | None = None
    geographic: bool | None = None
    after: datetime | None = None
    before: datetime | None = None
    place: str | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)
    where: Predicate | None = None
    exclude_last: int | timedelta | None = None
    exclude: tuple[str, ...] = ()

    @classmethod
    def around(cls, position: Position, radius_m: float) -> "Filters":
        """Selects the views within so many metres of a position that has coordinates, in the frame of these."""
        geographic = position.lat is not None
        first, second = (position.lat, position.lon) if geographic else (position.x, position.y)
        return cls(near=(float(first or 0), float(second or 0), radius_m), geographic=geographic)


@dataclass(frozen=True)
class Selection:
    """Views a search may return, by sequence number: `only` (None: all) without `never`, both ascending int64.

    `filters` are left to the index, which applies them inside its search; only one in the database takes any.
    """

    only: Sequence64 | None
    never: Sequence64
    filters: Filters | None = None


@dataclass(frozen=True)
class Replay:
    """The stored answer to a finished call with an Idempotency-Key."""

    status: int
    headers: Mapping[str, str]
    body: bytes


@dataclass(frozen=True, eq=False)
class Candidates:
    """The union of the channels' search results, at one revision of the map.

    Parameters
    ----------
    revision : int
        The map's revision that was searched.
    searched : int
        Number of views searched.
    seqs : int64 of shape (n,)
        Sequence numbers of the candidates, ascending: enrolment order.
    order : int64 of shape (n,)
        How many views of the map were enrolled before each of them.
    distances : mapping of channel to float32 of shape (n,)
        Euclidean distance (not squared), for all candidates.
    ranks : mapping of channel to int64 of shape (n,)
        From 1, nearest first, ties by enrolment order; 0 where only other channels found the candidate.
    """

    revision: int
    searched: int
    seqs: Sequence64
    order: Sequence64
    distances: Mapping[str, Floats]
    ranks: Mapping[str, Sequence64]


@dataclass(frozen=True, eq=False)
class VectorsFound:
    """What a database found for a search, at one revision of the map.

    Parameters
    ----------
    revision : int
        The map's revision that was searched.
    searched : int
        Number of views searched.
    seqs : int64 of shape (n,)
        Sequence numbers of the nearest views of all channels, ascending.
    vectors : float32 of shape (n, dimensions)
        Their histogram vectors, the channels concatenated in the recipe's order.
    order : int64 of shape (n,)
        How many views of the map were enrolled before each of them.
    """

    revision: int
    searched: int
    seqs: Sequence64
    vectors: Floats
    order: Sequence64
