"""Maps: made, shown, changed, deleted; and the jobs that change all of their views."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from schemas.recipe import DescriptionRecipe, MapRecipe
from schemas.records import JobRecord, MapCounts, MapRecord, Meaning, Removal
from worker.description.describers import Describers
from worker.description.ports import Encoder
from worker.description.presets import Wanted, changed_ranking, make_recipe
from worker.search.catalogue import Catalogue
from worker.service.ports import Jobs, Maps, Removals


@dataclass(frozen=True)
class MapState:
    """A map, its size, and how the encoder understands its labels."""

    record: MapRecord
    counts: MapCounts
    meanings: tuple[Meaning, ...]


class MapService:
    """The use-cases around maps.

    Parameters
    ----------
    maps, removals, jobs
        Parts of the store.
    encoder : Encoder
        That is running.
    describers : Describers
    catalogue : Catalogue
    preset : str
        Of maps that are made without naming one.
    wake : function
        Called when there is something to describe.
    """

    def __init__(
        self,
        *,
        maps: Maps,
        removals: Removals,
        jobs: Jobs,
        encoder: Encoder,
        describers: Describers,
        catalogue: Catalogue,
        preset: str,
        wake: Callable[[], None],
    ) -> None:
        self._maps, self._removals, self._jobs = maps, removals, jobs
        self._encoder, self._describers, self._catalogue = encoder, describers, catalogue
        self._preset, self._wake = preset, wake

    def all(self) -> list[MapState]:
        """All maps, by name."""
        return [self._state(record) for record in self._maps.all()]

    def get(self, name: str) -> MapState:
        """One map; raises NotFound."""
        return self._state(self._maps.get(name))

    def put(self, name: str, wanted: Wanted) -> tuple[MapState, bool]:
        """Make a map, or give an empty one another recipe; returns it and whether it is new.

        Raises
        ------
        InvalidParameters, Conflict
        """
        recipe = make_recipe(self._encoder, wanted, preset=self._preset)
        record, created = self._maps.put(name, recipe, datetime.now(UTC))
        return self._state(record), created

    def change_ranking(self, name: str, changes: Mapping[str, Any]) -> MapState:
        """Change some numbers of a map's ranking; the next query is ranked by them, nothing is described anew.

        Raises
        ------
        NotFound, InvalidParameters
        """
        return self._state(self._maps.change_ranking(name, lambda recipe: changed_ranking(recipe, changes)))

    def delete(self, name: str) -> Removal:
        """Remove a map and all its views; raises NotFound."""
        receipt = self._removals.delete_map(name)
        self._catalogue.forget(name)
        return receipt

    def switch_recipe(self, name: str, wanted: Wanted) -> JobRecord:
        """Describe a map's views by another recipe; the old one answers until the last view is done.

        What `wanted` leaves out stays as the map has it, unless it names another preset or the map was made with
        another encoder.

        Raises
        ------
        NotFound, Conflict, InvalidParameters
        """
        record = self._maps.get(name)
        present, ranking = record.description, record.ranking
        same = self._is_own(present) and wanted.preset in (None, ranking.preset)
        if same and wanted.labels is None:
            wanted = replace(wanted, labels=present.labels)
        if same and wanted.dynamic is None:
            wanted = replace(wanted, dynamic=[label for label in present.dynamic if label in (wanted.labels or ())])
        recipe = make_recipe(
            self._encoder,
            wanted,
            preset=ranking.preset,
            present=MapRecipe(description=present, ranking=ranking) if same else None,
            vocabulary=self._describers.of(present).vocabulary if same else None,
        )
        job = self._jobs.switch_recipe(name, recipe, datetime.now(UTC))
        self._wake()
        return job

    def train_vocabulary(self, name: str) -> JobRecord:
        """Train a vocabulary on a map's own views, then describe them by it; raises NotFound, Conflict."""
        job = self._jobs.queue_vocabulary(name, datetime.now(UTC))
        self._wake()
        return job

    def _state(self, record: MapRecord) -> MapState:
        labels = record.description.labels
        if self._is_own(record.description):
            meanings = tuple(self._encoder.meanings(labels))
        else:  # labels of an encoder that is not running
            meanings = tuple(Meaning(label, (), trained=False) for label in labels)
        return MapState(record, self._maps.counts(record.name), meanings)

    def _is_own(self, recipe: DescriptionRecipe) -> bool:
        return (recipe.encoder, recipe.weights) == (self._encoder.name, self._encoder.digest)
