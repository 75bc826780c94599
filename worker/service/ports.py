"""What the use-cases need of a store, part by part; each names only what is called here."""

import builtins
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import Protocol

from schemas.image import ImageFacts
from schemas.recipe import MapRecipe, RankingConfig
from schemas.records import (
    Filters,
    JobKind,
    JobRecord,
    JobState,
    MapCounts,
    MapRecord,
    Position,
    Removal,
    Selection,
    Submitted,
    ViewAttributes,
    ViewRecord,
)


class Maps(Protocol):
    """Maps by name."""

    def all(self) -> list[MapRecord]:
        """All maps, by name."""
        ...

    def get(self, name: str) -> MapRecord:
        """One map; raises NotFound."""
        ...

    def counts(self, name: str) -> MapCounts:
        """Size of a map; raises NotFound."""
        ...

    def put(self, name: str, recipe: MapRecipe, now: datetime) -> tuple[MapRecord, bool]:
        """Make a map, or give an empty one another recipe; raises Conflict when it has views and another recipe."""
        ...

    def change_ranking(self, name: str, change: Callable[[MapRecipe], RankingConfig]) -> MapRecord:
        """Replace a map's ranking in one transaction; raises NotFound, and what `change` raises."""
        ...


class Enrolment(Protocol):
    """Where images become durable."""

    def submit(
        self, name: str, image: bytes, facts: ImageFacts, attributes: ViewAttributes, recipe: MapRecipe, now: datetime
    ) -> Submitted:
        """Keep an image and queue its description; makes the map (with `recipe`) when there is none.

        Raises
        ------
        Conflict
            The same bytes are in the map with something else said about them.
        DiskFull
        """
        ...


class Views(Protocol):
    """Views by id."""

    def get(self, view_id: str) -> ViewRecord:
        """One view; raises NotFound."""
        ...

    def at(self, seqs: Sequence[int]) -> dict[int, ViewRecord]:
        """Views by sequence number; those deleted meanwhile are absent."""
        ...

    def list(
        self,
        name: str | None,
        filters: Filters,
        *,
        state: str | None = None,
        newest_first: bool = False,
        cursor: str | None = None,
        limit: int = 50,
    ) -> tuple[builtins.list[ViewRecord], str | None]:
        """A page of views in enrolment order, and the cursor of the next; raises InvalidParameters for a bad cursor."""
        ...

    def change(self, view_id: str, change: Callable[[ViewAttributes], ViewAttributes]) -> ViewRecord:
        """Replace what was said about a view in one transaction; raises NotFound, and what `change` raises."""
        ...

    def image(self, view_id: str) -> bytes:
        """The enrolled image, byte for byte; raises NotFound."""
        ...


class Removals(Protocol):
    """Deletions, complete."""

    def delete_view(self, view_id: str) -> Removal:
        """Remove a view; raises NotFound."""
        ...

    def delete_views(self, name: str, filters: Filters) -> Removal:
        """Remove all views of a map that fit; raises NotFound."""
        ...

    def delete_map(self, name: str) -> Removal:
        """Remove a map, its views and their images; raises NotFound."""
        ...


class Listings(Protocol):
    """Which views and places there are."""

    def select(self, name: str, filters: Filters) -> Selection:
        """The views of a map that filters allow; raises NotFound."""
        ...

    def places(
        self, name: str | None, cursor: str | None, limit: int
    ) -> tuple[list[tuple[str, str, int, Position, datetime]], str | None]:
        """A page of (map, place, views, mean position, last enrolment), by map and place."""
        ...


class JobQueue(Protocol):
    """How much waits to be described."""

    def count_waiting(self, *, redescriptions: bool = False) -> int:
        """Enrolments not yet described; with `redescriptions` the views of a recipe switch too."""
        ...


class Jobs(Protocol):
    """Work in the background."""

    def get(self, job_id: str) -> JobRecord:
        """One job; raises NotFound."""
        ...

    def list(
        self,
        name: str | None,
        *,
        kind: JobKind | None = None,
        state: JobState | None = None,
        cursor: str | None = None,
        limit: int = 50,
    ) -> tuple[builtins.list[JobRecord], str | None]:
        """A page of jobs, newest first, and the cursor of the next."""
        ...

    def cancel(self, job_id: str, now: datetime) -> JobRecord:
        """Cancel a job; raises NotFound, or Conflict when it is past that."""
        ...

    def switch_recipe(self, name: str, recipe: MapRecipe, now: datetime) -> JobRecord:
        """Begin to re-describe a map's views; raises NotFound, Conflict."""
        ...

    def queue_vocabulary(self, name: str, now: datetime) -> JobRecord:
        """Queue the training of a vocabulary on a map's views; raises NotFound, Conflict."""
        ...
