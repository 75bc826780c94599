"""Ports of the use-cases to the store; each declares only the methods that the use-cases call."""

import builtins
from collections.abc import Callable, Collection, Sequence
from datetime import datetime
from typing import Protocol

from schemas.comparisons import MapLevels
from schemas.description import Floats
from schemas.map_changes import MapChanges
from schemas.recipe import MapRecipe
from schemas.records import (
    Filters,
    JobKind,
    JobRecord,
    JobState,
    MapCounts,
    MapRecord,
    PlaceRecord,
    Selection,
    ViewAttributes,
    ViewRecord,
)
from schemas.removal import Removal
from worker.search.ports import ComparisonReader


class Maps(Protocol):
    """Maps by name."""

    def all(self) -> list[MapRecord]:
        """All maps, sorted by name."""
        ...

    def get(self, name: str) -> MapRecord:
        """One map; raises NotFound."""
        ...

    def labels(self, recipe: str) -> tuple[str, ...]:
        """Labels of a recipe, to which the shares of its descriptions refer; empty once no map or view uses it."""
        ...

    def counts(self, name: str) -> MapCounts:
        """Size of a map; raises NotFound."""
        ...

    def counts_of_all(self) -> dict[str, MapCounts]:
        """Sizes of all maps by their names."""
        ...

    def change(self, name: str, changes: MapChanges) -> MapRecord:
        """Change settings of a map in one transaction; raises NotFound, Conflict, and what `changes.ranking` raises."""
        ...

    def refuses_poor(self, name: str) -> bool:
        """Whether a map refuses poor images; False where there is no such map."""
        ...

    def put(self, name: str, recipe: MapRecipe, now: datetime) -> tuple[MapRecord, bool]:
        """Create a map, or replace the recipe of an empty one; raises Conflict when it has views and another recipe."""
        ...

    def set_calibration(self, name: str, calibration: str | None, fitted_to: MapRecipe | None = None) -> MapRecord:
        """Give a map a calibration of its own, or None; raises NotFound, and Conflict when `fitted_to` is outdated."""
        ...


class Views(Protocol):
    """Views by id."""

    def get(self, view_id: str) -> ViewRecord:
        """One view; raises NotFound."""
        ...

    def at(self, seqs: Sequence[int], recipe: str | None = None) -> dict[int, ViewRecord]:
        """Views by sequence number, described by their map's recipe or another one; those deleted are absent."""
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
        among: Collection[str] | None = None,
    ) -> tuple[builtins.list[ViewRecord], str | None]:
        """A page of views in enrolment order, and the cursor of the next; raises InvalidParameters for a bad cursor.

        `among`: of these maps alone.
        """
        ...

    def ranked(
        self,
        name: str,
        filters: Filters,
        score: Callable[[Sequence[str], Floats], Floats],
        *,
        cursor: str | None = None,
        limit: int = 50,
    ) -> tuple[builtins.list[ViewRecord], str | None]:
        """A page of a map's described views by a score above 0 of their label shares, and the cursor of the next."""
        ...

    def change(self, view_id: str, change: Callable[[ViewAttributes], ViewAttributes]) -> ViewRecord:
        """Replace a view's attributes in one transaction; raises NotFound, and what `change` raises."""
        ...

    def image(self, view_id: str) -> bytes:
        """The enrolled image, byte for byte; raises NotFound."""
        ...


class Removals(Protocol):
    """Deletions: rows, vectors and image files."""

    def delete_view(self, view_id: str, *, undoes: bool = False) -> Removal:
        """Remove a view; raises NotFound.

        `undoes`: nobody was told of it, and an import may bring its image; raises Conflict where somebody was.
        """
        ...

    def delete_views(self, name: str, filters: Filters) -> Removal:
        """Remove all views of a map that the filters select; raises NotFound."""
        ...

    def delete_map(self, name: str) -> Removal:
        """Remove a map, its views and their images; raises NotFound."""
        ...


class Listings(Protocol):
    """Selections of views, and places."""

    def select(self, name: str, filters: Filters) -> Selection:
        """The views of a map that the filters select; raises NotFound."""
        ...

    def places(
        self, name: str | None, cursor: str | None, limit: int, among: Collection[str] | None = None
    ) -> tuple[list[PlaceRecord], str | None]:
        """A page of places by map and name, and the cursor of the next."""
        ...


class Comparisons(ComparisonReader, Protocol):
    """What the views of a map find in it."""

    def levels(self, name: str, recipe: str | None = None) -> MapLevels:
        """Means over the compared views of a map, by its recipe or another one; raises NotFound."""
        ...


class Pending(Protocol):
    """Views that wait to be described."""

    def count_pending(self, name: str) -> int:
        """Number of a map's views that are not described yet by its recipe; raises NotFound."""
        ...


class JobQueue(Protocol):
    """Length of the queue of descriptions."""

    def count_waiting(self) -> int:
        """Enrolments not yet described."""
        ...


class UploadRemoval(Protocol):
    """Recordings until they are imported."""

    def discard(self, job_id: str) -> None:
        """Remove the file of an import that has ended; does nothing when there is none."""
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
        kinds: Collection[JobKind] = (),
        state: JobState | None = None,
        cursor: str | None = None,
        limit: int = 50,
        among: Collection[str] | None = None,
    ) -> tuple[builtins.list[JobRecord], str | None]:
        """A page of jobs, newest first, and the cursor of the next; `kinds`: of these alone, none: of all."""
        ...

    def cancel(self, job_id: str, now: datetime) -> JobRecord:
        """Cancel a job; raises NotFound, or Conflict when it can no longer be cancelled."""
        ...

    def switch_recipe(
        self, name: str, recipe: MapRecipe, now: datetime, made_from: MapRecipe | None = None
    ) -> JobRecord:
        """Begin to describe a map's views by another recipe.

        Raises NotFound, Conflict, and RecipeChanged when the map's recipe is not `made_from`.
        """
        ...

    def begin_shadow(
        self, name: str, recipe: MapRecipe, wanted: int, now: datetime, made_from: MapRecipe | None = None
    ) -> JobRecord:
        """Begin to describe a map's views by another recipe, and to compare answers; raises as `switch_recipe`."""
        ...

    def queue_vocabulary(self, name: str, now: datetime) -> JobRecord:
        """Queue the training of a vocabulary on a map's views; raises NotFound, Conflict."""
        ...

    def unfinished_imports(self, name: str | None = None) -> set[str]:
        """Ids of the imports, into a map if one is named, that wait or run."""
        ...
