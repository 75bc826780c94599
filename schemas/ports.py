"""The three promises the house is built on: an encoder, a store, an index."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from schemas.description import Appearance, Description, Floats, LocalFeatures, PixelField
from schemas.picture import Picture, PictureFacts
from schemas.recipe import Recipe

Sequence64 = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Meaning:
    """How an encoder understands a word.

    Parameters
    ----------
    word : str
        As the user wrote it.
    mapped_to : tuple of str
        The encoder's own words that stand for it; (word,) when it knows the word itself.
    trained : bool
        Whether labelled pixels of it were seen in training.
    """

    word: str
    mapped_to: tuple[str, ...]
    trained: bool


class Encoder(Protocol):
    """Turns pictures into fields of language-aligned embeddings. Deterministic on one machine type."""

    @property
    def name(self) -> str:
        """``color``, ``compact`` or ``lseg``."""
        ...

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of the weights; with the name it decides every embedding."""
        ...

    @property
    def layers(self) -> Mapping[str, int]:
        """Channels of each layer of its fields; ``words`` is always there."""
        ...

    def encode(self, pictures: Sequence[Picture]) -> Iterator[PixelField]:
        """One field per picture, in order, each independent of the others in the batch."""
        ...

    def text_vectors(self, words: Sequence[str]) -> Floats:
        """Unit-length vectors of words, float32 (words, channels of the layer ``words``).

        Raises
        ------
        InvalidParameters
            Names each word it does not know, and those it does.
        """
        ...

    def meanings(self, words: Sequence[str]) -> list[Meaning]:
        """How each word is understood; raises as `text_vectors`."""
        ...


@dataclass(frozen=True)
class Where:
    """A position; metres (x, y, z) or degrees (lat, lon, alt), never both. All None: not said."""

    x: float | None = None
    y: float | None = None
    z: float | None = None
    lat: float | None = None
    lon: float | None = None
    alt: float | None = None
    heading: float | None = None


@dataclass(frozen=True)
class Said:
    """What the user said about a view."""

    place: str | None = None
    where: Where = Where()
    captured_at: datetime | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class MapRecord:
    """A map as the store knows it."""

    name: str
    revision: int
    recipe: Recipe
    created_at: datetime


@dataclass(frozen=True)
class MapCounts:
    """Size of a map: views by state, places, bytes of pictures, and the box of positions, if any."""

    views: Mapping[str, int]
    places: int
    picture_bytes: int
    lowest: Where
    highest: Where


@dataclass(frozen=True)
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
    said: Said
    enrolled_at: datetime
    picture: PictureFacts
    state: Literal["pending", "ready", "failed"]
    failure: tuple[str, str] | None
    description: DescriptionRecord | None


@dataclass(frozen=True)
class JobRecord:
    """A picture waiting to be described, being described, or done."""

    id: str
    state: Literal["waiting", "running", "done", "failed", "cancelled"]
    map: str
    view_id: str | None
    attempts: int
    created_at: datetime
    finished_at: datetime | None
    failure: tuple[str, str] | None


@dataclass(frozen=True)
class Claim:
    """A job a worker holds until its lease ends.

    Parameters
    ----------
    token : str
        Proves the lease: `Store.finish` with an outdated token raises LeaseLost.
    """

    job_id: str
    token: str
    view: ViewRecord
    recipe: Recipe
    attempts: int


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
    pictures: int
    revision: int | None


class Store(Protocol):
    """Maps, views, jobs, vocabularies and pictures: the truth. What a method has returned from is durable."""

    # maps
    def maps(self) -> list[MapRecord]:
        """All maps, by name."""
        ...

    def map(self, name: str) -> MapRecord:
        """One map; raises NotFound."""
        ...

    def counts(self, name: str) -> MapCounts:
        """Size of a map; raises NotFound."""
        ...

    def put_map(self, name: str, recipe: Recipe, now: datetime) -> tuple[MapRecord, bool]:
        """Make a map, or give an empty one another recipe; returns it and whether it is new.

        Raises
        ------
        Conflict
            The map has views and another recipe.
        """
        ...

    def delete_map(self, name: str) -> Removal:
        """Remove a map, its views and their pictures; raises NotFound."""
        ...

    def switch_recipe(self, name: str, recipe: Recipe, now: datetime) -> int:
        """Begin to re-describe a map's views by another recipe; returns how many jobs that takes.

        Searches go on with the old recipe until the last view is described by the new one; then the map changes
        over in one transaction. Descriptions that the new recipe already has (a roll-back) are used again.

        Raises
        ------
        Conflict
            A switch is under way already.
        """
        ...

    # enrolment and work
    def submit(
        self, name: str, picture: bytes, facts: PictureFacts, said: Said, recipe: Recipe, now: datetime
    ) -> Submitted:
        """Keep a picture and queue its description; makes the map (with `recipe`) when there is none.

        Raises
        ------
        Conflict
            The same bytes are in the map with something else said about them.
        DiskFull
        """
        ...

    def claim(self, worker: str, count: int, lease: timedelta, now: datetime) -> list[Claim]:
        """Take up to `count` of the oldest waiting jobs, or jobs whose lease has ended; never more than thrice."""
        ...

    def finish(self, claim: Claim, description: Description, now: datetime) -> int:
        """Keep a description: the view is searchable from the returned revision on; raises LeaseLost."""
        ...

    def fail(self, claim: Claim, code: str, detail: str, now: datetime) -> None:
        """Give a job up; the view stays, `failed`, with this reason; raises LeaseLost."""
        ...

    def release(self, claim: Claim) -> None:
        """Put a job back unharmed (shutting down); does not count as an attempt."""
        ...

    def waiting(self) -> int:
        """Jobs not yet finished."""
        ...

    def job(self, job_id: str) -> JobRecord:
        """One job; raises NotFound."""
        ...

    def cancel(self, job_id: str, now: datetime) -> JobRecord:
        """Cancel a job that is waiting; raises NotFound, or Conflict when it is past that."""
        ...

    # views
    def view(self, view_id: str) -> ViewRecord:
        """One view; raises NotFound."""
        ...

    def views(
        self,
        name: str | None,
        filters: Filters,
        *,
        state: str | None = None,
        newest_first: bool = False,
        cursor: str | None = None,
        limit: int = 50,
    ) -> tuple[list[ViewRecord], str | None]:
        """A page of views in enrolment order, and the cursor of the next; raises InvalidParameters for a bad cursor."""
        ...

    def places(
        self, name: str | None, cursor: str | None, limit: int
    ) -> tuple[list[tuple[str, str, int, Where, datetime]], str | None]:
        """A page of (map, place, views, mean position, last enrolment), by map and place."""
        ...

    def patch(self, view_id: str, said: Said) -> ViewRecord:
        """Replace what was said about a view; raises NotFound."""
        ...

    def delete_view(self, view_id: str) -> Removal:
        """Remove a view completely; raises NotFound."""
        ...

    def delete_views(self, name: str, filters: Filters) -> Removal:
        """Remove all views of a map that fit; raises NotFound."""
        ...

    def picture(self, view_id: str) -> bytes:
        """The enrolled picture, byte for byte; raises NotFound."""
        ...

    # what an index and a ranking need
    def revision(self, name: str) -> int:
        """The map's revision; raises NotFound."""
        ...

    def since(self, name: str, revision: int) -> Changes:
        """All that an index at `revision` needs to be up to date (0: everything)."""
        ...

    def select(self, name: str, filters: Filters) -> Selection:
        """The views of a map that filters allow."""
        ...

    def views_at(self, seqs: Sequence[int]) -> dict[int, ViewRecord]:
        """Views by sequence number; those deleted meanwhile are absent."""
        ...

    def appearances(self, seqs: Sequence[int], recipe: str) -> dict[int, Appearance]:
        """Cells and graphs of these views; those deleted meanwhile are absent."""
        ...

    def local_features(self, seqs: Sequence[int], recipe: str) -> dict[int, LocalFeatures]:
        """Keypoints of these views; those deleted meanwhile are absent."""
        ...

    # vocabularies
    def keep_vocabulary(self, digest: str, tensors: bytes) -> None:
        """Keep a map's own vocabulary (safetensors bytes) under the SHA-256 that a recipe names."""
        ...

    def vocabulary(self, digest: str) -> bytes:
        """A kept vocabulary; raises NotFound."""
        ...

    # repeated calls
    def begin_call(self, key: str, fingerprint: str, now: datetime) -> Replay | None:
        """Claim an Idempotency-Key; the answer to repeat when the call has finished within 24 hours.

        Raises
        ------
        Conflict
            The first call still runs.
        KeyReused
            The key came with another fingerprint.
        """
        ...

    def end_call(self, key: str, replay: Replay, now: datetime) -> None:
        """Remember the answer of a call."""
        ...

    def abandon_call(self, key: str) -> None:
        """Forget a call that failed, so that it can be tried again."""
        ...

    # care
    def recover(self, now: datetime) -> None:
        """After a crash: forget half-made calls and picture files that no view owns."""
        ...

    def check(self) -> str:
        """``ok``, or what is wrong with the database or the folder."""
        ...

    def close(self) -> None:
        """Let go of files and connections."""
        ...


@dataclass(frozen=True)
class Neighbours:
    """Answer of one channel's search.

    Parameters
    ----------
    seqs : int64 of shape (n,)
        Nearest first; ties by seq (enrolment order).
    distances : float32 of shape (n,)
        Euclidean (not squared).
    """

    seqs: Sequence64
    distances: Floats


class Index(Protocol):
    """Nearest histograms of one map, per channel. A cache of the Store: losing it loses nothing."""

    @property
    def revision(self) -> int:
        """The map's revision it has caught up to."""
        ...

    @property
    def recipe(self) -> str:
        """Id of the recipe whose vectors it holds."""
        ...

    def __len__(self) -> int: ...

    def apply(self, changes: Changes) -> None:
        """Catch up."""
        ...

    def nearest(self, channel: str, vector: Floats, count: int, selection: Selection) -> Neighbours:
        """Up to `count` views of the selection."""
        ...

    def distances(self, channel: str, vector: Floats, seqs: Sequence[int]) -> Floats:
        """Euclidean distances to particular views, float32 (n,)."""
        ...

    def searchable(self, selection: Selection) -> int:
        """How many views a search in this selection looks at."""
        ...
