"""The three promises the house is built on: an encoder, a store, an index."""

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timedelta
from typing import Protocol

from schemas.description import Appearance, Description, Floats, Int8s, LocalFeatures, PixelField
from schemas.image import Image, ImageFacts
from schemas.recipe import Recipe
from schemas.records import (
    Candidates,
    Changes,
    Claim,
    Filters,
    JobRecord,
    MapCounts,
    MapRecord,
    Meaning,
    Position,
    Removal,
    Replay,
    Selection,
    Submitted,
    ViewAttributes,
    ViewRecord,
)


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

    def encode(self, images: Sequence[Image]) -> Iterator[PixelField]:
        """One field per picture, in order, each independent of the others in the batch."""
        ...

    def fine(self, image: Image) -> PixelField:
        """The picture at the finest grid that the encoder has, for people to look at; the layer ``words`` is enough.

        In the same space as the fields of `encode`, of which everything that is stored is made.
        """
        ...

    def text_vectors(self, words: Sequence[str]) -> Floats:
        """Vectors of words, float32 (words, channels of the layer ``words``): a cell's inner product with one is their
        cosine. Not longer than 1; shorter by what lies outside the space that cells can reach.

        Raises
        ------
        InvalidParameters
            Names each word it does not know, and those it does.
        """
        ...

    def meanings(self, words: Sequence[str]) -> list[Meaning]:
        """How each word is understood; raises as `text_vectors`."""
        ...


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
        self, name: str, image: bytes, facts: ImageFacts, attributes: ViewAttributes, recipe: Recipe, now: datetime
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
        """Take up to `count` of the oldest waiting jobs, or jobs whose lease has ended; never more than thrice.

        Enrolments, for which somebody may be waiting, go before the jobs of a recipe switch.
        """
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

    def waiting(self, *, redescriptions: bool = False) -> int:
        """Enrolments not yet described.

        Parameters
        ----------
        redescriptions : bool
            Count the jobs of a recipe switch too. Enrolments go before them, so they delay none.
        """
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
    ) -> tuple[list[tuple[str, str, int, Position, datetime]], str | None]:
        """A page of (map, place, views, mean position, last enrolment), by map and place."""
        ...

    def patch(self, view_id: str, attributes: ViewAttributes) -> ViewRecord:
        """Replace what was said about a view; raises NotFound."""
        ...

    def delete_view(self, view_id: str) -> Removal:
        """Remove a view completely; raises NotFound."""
        ...

    def delete_views(self, name: str, filters: Filters) -> Removal:
        """Remove all views of a map that fit; raises NotFound."""
        ...

    def image(self, view_id: str) -> bytes:
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
        """Cells at half size, graphs and extents of these views; those deleted meanwhile are absent."""
        ...

    def cells(self, seqs: Sequence[int], recipe: str) -> dict[int, Int8s]:
        """Cells in full of these views, (rows, columns, dimensions); those deleted meanwhile are absent."""
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

    def search(self, vectors: Mapping[str, Floats], count: int, selection: Selection) -> Candidates:
        """The `count` nearest views of the selection by each channel, joined.

        Parameters
        ----------
        vectors : mapping of channel to float32 of shape (dimensions,)
        count : int
            Of each channel.
        """
        ...
