"""What the store, the index and the encoder hand over: frozen records without behaviour."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from schemas.description import Floats
from schemas.image import ImageFacts
from schemas.recipe import DescriptionRecipe, MapRecipe, RankingConfig

Sequence64 = npt.NDArray[np.int64]

JobState = Literal["waiting", "running", "done", "failed", "cancelled"]
JobKind = Literal["describe", "recipe", "vocabulary"]
ViewState = Literal["pending", "ready", "failed"]


@dataclass(frozen=True)
class Meaning:
    """How an encoder understands a label.

    Parameters
    ----------
    label : str
        As the user wrote it.
    mapped_to : tuple of str
        The encoder's own labels that stand for it; (label,) when it knows the label itself.
    trained : bool
        Whether labelled pixels of it were seen in training.
    """

    label: str
    mapped_to: tuple[str, ...]
    trained: bool


@dataclass(frozen=True)
class Position:
    """A position; metres (x, y, z) or degrees (lat, lon, alt), never both. All None: not said."""

    x: float | None = None
    y: float | None = None
    z: float | None = None
    lat: float | None = None
    lon: float | None = None
    alt: float | None = None
    heading: float | None = None


@dataclass(frozen=True)
class ViewAttributes:
    """What the user said about a view."""

    place: str | None = None
    position: Position = Position()
    captured_at: datetime | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class MapRecord:
    """A map as the store knows it."""

    name: str
    revision: int
    description: DescriptionRecipe
    ranking: RankingConfig
    created_at: datetime

    @property
    def recipe(self) -> MapRecipe:
        """Both halves together."""
        return MapRecipe(description=self.description, ranking=self.ranking)


@dataclass(frozen=True)
class MapCounts:
    """Size of a map: views by state, places, bytes of images, and the box of positions, if any."""

    views: Mapping[str, int]
    places: int
    image_bytes: int
    lowest: Position
    highest: Position


@dataclass(frozen=True, eq=False)
class DescriptionRecord:
    """The small facts of a description that every answer shows."""

    recipe: str
    descriptor_count: int
    static_share: float
    label_shares: Floats
    nodes: int


@dataclass(frozen=True)
class ViewRecord:
    """A view as the store knows it.

    Parameters
    ----------
    seq : int
        Grows with every enrolment in the store; the index's id.
    """

    id: str
    seq: int
    map: str
    attributes: ViewAttributes
    enrolled_at: datetime
    image: ImageFacts
    state: ViewState
    failure: tuple[str, str] | None
    description: DescriptionRecord | None


@dataclass(frozen=True)
class JobProgress:
    """How far a job is: `done` of `total` images."""

    done: int
    total: int


@dataclass(frozen=True)
class JobRecord:
    """A piece of work in the background, durable.

    Parameters
    ----------
    kind : str
        ``describe``: one view; ``recipe``: all views of a map by another recipe; ``vocabulary``: train one on a map's
        views, then describe them by it.
    view_id : str or None
        Of a describe job.
    progress : JobProgress or None
        None of a describe job, which is one step.
    result : mapping or None
        What a finished job made, such as the recipe's id.
    failure : (str, str) or None
        Code and detail.
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
    failure: tuple[str, str] | None


@dataclass(frozen=True)
class Claim:
    """A describe job that a worker holds until its lease ends.

    Parameters
    ----------
    token : str
        Proves the lease: finishing with an outdated token raises LeaseLost.
    """

    job_id: str
    token: str
    view: ViewRecord
    recipe: DescriptionRecipe
    attempts: int


@dataclass(frozen=True)
class MapClaim:
    """A job of a whole map that a worker holds until its lease ends; reporting progress renews it."""

    job_id: str
    kind: JobKind
    token: str
    map: str


@dataclass(frozen=True)
class Submitted:
    """A view that is durable: `created` is False when the same bytes were in the map already."""

    view: ViewRecord
    job_id: str | None
    created: bool
    revision: int


@dataclass(frozen=True)
class Changes:
    """What happened to a map's searchable views after a revision.

    Parameters
    ----------
    revision : int
        The map's revision this brings an index to.
    recipe : str
        Id of the map's recipe at that revision; an index of another recipe starts anew.
    seqs : int64 of shape (n,)
        Views described since, ascending.
    vectors : float32 of shape (n, dimensions)
        Their vectors, the recipe's channels side by side in the recipe's order.
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
    """Which views a search or a listing is about; empty fields do not restrict.

    Parameters
    ----------
    near : (float, float, float) or None
        (x, y, radius in metres), or (lat, lon, radius in metres) when `geographic`.
    after, before : datetime or None
        Bounds of `captured_at`, both inclusive.
    exclude_last : int or timedelta or None
        Not the newest N views, or not those enrolled within this time of the newest one.
    exclude : tuple of str
        View ids.
    """

    near: tuple[float, float, float] | None = None
    geographic: bool = False
    after: datetime | None = None
    before: datetime | None = None
    place: str | None = None
    metadata: Mapping[str, str] = field(default_factory=dict)
    exclude_last: int | timedelta | None = None
    exclude: tuple[str, ...] = ()


@dataclass(frozen=True)
class Selection:
    """The views a search may return: all of `only` (None: every view) without `never`, both ascending int64."""

    only: Sequence64 | None
    never: Sequence64


@dataclass(frozen=True)
class Replay:
    """A finished call, as it was answered."""

    status: int
    headers: Mapping[str, str]
    body: bytes


@dataclass(frozen=True)
class Removal:
    """What a deletion took away."""

    views: int
    images: int
    revision: int | None


@dataclass(frozen=True, eq=False)
class Candidates:
    """The union of what each channel's search found, at one revision of the map.

    Parameters
    ----------
    revision : int
        The map's revision that was searched.
    searched : int
        How many views the search looked at.
    seqs : int64 of shape (n,)
        Ascending, that is in enrolment order.
    distances : mapping of channel to float32 of shape (n,)
        Euclidean (not squared), for every candidate whichever channel found it.
    ranks : mapping of channel to int64 of shape (n,)
        From 1, nearest first, ties by enrolment order; 0 where the channel did not find the candidate itself.
    """

    revision: int
    searched: int
    seqs: Sequence64
    distances: Mapping[str, Floats]
    ranks: Mapping[str, Sequence64]
