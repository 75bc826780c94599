"""Maps: created, shown, changed, deleted; and the jobs that describe all their views again."""

from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from typing import Any

from schemas.comparisons import MapLevels
from schemas.errors import InvalidParameters, NotFound, ParameterError, RecipeChanged
from schemas.map_changes import MapChanges
from schemas.recipe import DescriptionRecipe, MapRecipe
from schemas.records import JobRecord, MapCounts, MapRecord, Meaning
from schemas.removal import Removal
from worker.description.describers import Describers
from worker.description.ports import Encoder
from worker.description.preset_differences import USERS_OWN, PresetDifference, PresetDifferences
from worker.description.presets import Wanted, changed_ranking, make_recipe
from worker.method.calibration import Calibration
from worker.method.own_calibration import OwnCalibration
from worker.search.ports import Catalogue
from worker.service.blurring import Blurring
from worker.service.calibrating import own_calibration
from worker.service.known_levels import KnownLevels
from worker.service.ports import Comparisons, Jobs, Maps, Removals, UploadRemoval
from worker.service.trouble import STORAGE_ERRORS

ATTEMPTS = 5
"""How often the next recipe of a map is made, whose present one is changed meanwhile."""


@dataclass(frozen=True)
class MapState:
    """A map, its size, its calibration (`own`, or the shipped one), how the encoder understands its labels, and where
    its recipe differs from its preset."""

    record: MapRecord
    counts: MapCounts
    levels: MapLevels
    calibration: Calibration
    own: OwnCalibration | None
    meanings: tuple[Meaning, ...]
    preset_differences: tuple[PresetDifference, ...]


class MapService:
    """The use-cases around maps.

    Parameters
    ----------
    maps, removals, jobs, uploads, comparisons
        Parts of the store.
    shipped : function
        Recipe to the calibration shipped for it.
    encoder : Encoder
        The running encoder.
    describers : Describers
    catalogue : Catalogue
    preset : str
        Preset of maps that are created without naming one.
    blurring : Blurring
    wake : function
        Called when a job was queued.
    """

    def __init__(
        self,
        *,
        maps: Maps,
        removals: Removals,
        jobs: Jobs,
        uploads: UploadRemoval,
        comparisons: Comparisons,
        shipped: Callable[[MapRecipe], Calibration],
        encoder: Encoder,
        describers: Describers,
        catalogue: Catalogue,
        preset: str,
        blurring: Blurring,
        wake: Callable[[], None],
    ) -> None:
        self._maps, self._removals, self._jobs, self._uploads = maps, removals, jobs, uploads
        self._levels, self._shipped = KnownLevels(comparisons), shipped
        self._encoder, self._describers, self._catalogue = encoder, describers, catalogue
        self._differences = PresetDifferences(encoder)
        self._preset, self._blurring, self._wake = preset, blurring, wake

    def all(self, among: Collection[str] | None = None) -> list[MapState]:
        """All maps, or those of some names, sorted by name; without those that are deleted while they are counted."""
        states, counts = [], self._maps.counts_of_all()
        for record in self._maps.all():
            if among is None or record.name in among:
                with suppress(NotFound):
                    states.append(self._state(record, counts.get(record.name)))
        return states

    def get(self, name: str) -> MapState:
        """One map; raises NotFound."""
        return self._state(self._maps.get(name))

    def put(self, name: str, wanted: Wanted) -> tuple[MapState, bool]:
        """Create a map, or replace the recipe of an empty one; returns the map and whether it was created.

        Raises
        ------
        InvalidParameters, Conflict
        """
        recipe = make_recipe(self._encoder, wanted, preset=self._preset)
        record, created = self._maps.put(name, recipe, datetime.now(UTC))
        return self._state(record), created

    def change(
        self,
        name: str,
        *,
        ranking: Mapping[str, Any] | None = None,
        blur: Sequence[str] | None = None,
        keep_images: bool | None = None,
        keep_queries: int | None = None,
        keep_matches: int | None = None,
        refuse_poor: bool | None = None,
    ) -> MapState:
        """Change what is given of a map, all of it or, when one of them is refused, nothing.

        Parameters
        ----------
        name : str
        ranking : mapping or None
            Parameters of the ranking, effective from the next query; no view is described again.
        blur : sequence of str or None
            What is covered in each image before it is stored; empty: store images as they are sent.
        keep_images : bool or None
            False removes all images now, and each later one once it is described.
        keep_queries, keep_matches : int or None
            Keep at most so many queries that matched nothing, or a view that they look unlike; 0 for none.
        refuse_poor : bool or None
            Refuse images that are dark, overexposed, covered or blurred.

        Raises
        ------
        NotFound
        InvalidParameters
            All that are invalid; or the encoder knows nothing that a word of `blur` names.
        Conflict
            The map has views, in whose images not all of `blur` is covered; a job reads the images that are to be
            removed; or images are to be kept again, but those of views are gone.
        """
        errors: list[ParameterError] = []
        words = None
        try:
            words = None if blur is None else self._blurring.checked(blur)
        except InvalidParameters as error:
            errors += error.errors
        if ranking is not None:
            try:
                changed_ranking(self._maps.get(name).recipe, ranking)
            except InvalidParameters as error:
                errors += error.errors
        if errors:
            raise InvalidParameters(errors)
        changes = MapChanges(
            # Anew in the transaction: another call may have changed the ranking since.
            ranking=None if ranking is None else partial(changed_ranking, changes=ranking),
            blur=words,
            keep_images=keep_images,
            keep_queries=keep_queries,
            keep_matches=keep_matches,
            refuse_poor=refuse_poor,
        )
        return self._state(self._maps.change(name, changes))

    def delete(self, name: str) -> Removal:
        """Remove a map and all its views; raises NotFound."""
        imports = self._jobs.unfinished_imports(name)
        try:
            receipt = self._removals.delete_map(name)
        except STORAGE_ERRORS:  # it is finished later, if its name is gone: with that went its jobs
            with suppress(*STORAGE_ERRORS):
                self._discard(imports - self._jobs.unfinished_imports())
            raise
        self._discard(imports)
        self._catalogue.forget(name)
        return receipt

    def _discard(self, imports: Collection[str]) -> None:
        """Remove the recordings of imports that went with their map."""
        for job_id in imports:
            self._uploads.discard(job_id)

    def switch_recipe(self, name: str, wanted: Wanted) -> JobRecord:
        """Describe a map's views by another recipe; queries use the old recipe until the last view is described.

        Fields that `wanted` leaves None keep the map's values. A preset that is named brings its parameters and ranking
        as this version has them, another one its labels and vocabulary too, and so does a map of another encoder.
        `USERS_OWN` stays with the map in any case.

        Raises
        ------
        NotFound, Conflict, InvalidParameters
        """

        def begin(following: MapRecipe, present: MapRecipe) -> JobRecord:
            self._catalogue.prepare(name, following.description)  # it may be described already
            return self._jobs.switch_recipe(name, following, datetime.now(UTC), present)

        return self._begin(name, wanted, begin)

    def begin_shadow(self, name: str, wanted: Wanted, queries: int) -> JobRecord:
        """Describe a map's views by another recipe, answer its last queries by both, and wait to be told which stays.

        Parameters
        ----------
        name : str
        wanted : Wanted
            As for `switch_recipe`.
        queries : int
            How many queries are answered by both.

        Raises
        ------
        NotFound, Conflict, InvalidParameters
        """

        def begin(following: MapRecipe, present: MapRecipe) -> JobRecord:
            return self._jobs.begin_shadow(name, following, queries, datetime.now(UTC), present)

        return self._begin(name, wanted, begin)

    def _begin(self, name: str, wanted: Wanted, begin: Callable[[MapRecipe, MapRecipe], JobRecord]) -> JobRecord:
        """Begin what leads to the recipe that is wanted; `begin` gets it and the map's own, from which it was made."""

        def attempt() -> JobRecord:
            present = self._maps.get(name).recipe
            job = begin(self._following(present, wanted), present)
            self._wake()
            return job

        for _ in range(ATTEMPTS - 1):
            with suppress(RecipeChanged):  # since it was read: the next one would undo that
                return attempt()
        return attempt()

    def _following(self, recipe: MapRecipe, wanted: Wanted) -> MapRecipe:
        """The recipe that a map's own becomes by what is wanted."""
        present, ranking = recipe.description, recipe.ranking
        same = self._is_own(present) and wanted.preset in (None, ranking.preset)
        if same and wanted.labels is None:
            wanted = replace(wanted, labels=present.labels)
        if same and wanted.dynamic is None:
            wanted = replace(wanted, dynamic=[label for label in present.dynamic if label in (wanted.labels or ())])
        own = {name: getattr(ranking, name) for name in USERS_OWN}
        wanted = replace(wanted, ranking={**own, **(wanted.ranking or {})})
        return make_recipe(
            self._encoder,
            wanted,
            preset=ranking.preset,
            present=recipe if same else None,
            vocabulary=self._describers.of(present).vocabulary if same else None,
        )

    def train_vocabulary(self, name: str) -> JobRecord:
        """Train a vocabulary on a map's views, then describe them with it; raises NotFound, Conflict, SetupError."""
        self._describers.of(self._maps.get(name).description)
        job = self._jobs.queue_vocabulary(name, datetime.now(UTC))
        self._wake()
        return job

    def _state(self, record: MapRecord, counts: MapCounts | None = None) -> MapState:
        labels = record.description.labels
        if self._is_own(record.description):
            meanings = tuple(self._encoder.meanings(labels))
            differences = self._differences.of(record.recipe)
        else:  # of an encoder that is not running, for which the preset may be another one
            meanings = tuple(Meaning(label, (), trained=False) for label in labels)
            differences = ()
        counts, levels = counts or self._maps.counts(record.name), self._levels.of(record)
        own = None if record.calibration is None else own_calibration(record.calibration)
        calibration = self._shipped(record.recipe) if own is None else own.calibration
        return MapState(record, counts, levels, calibration, own, meanings, differences)

    def _is_own(self, recipe: DescriptionRecipe) -> bool:
        return (recipe.encoder, recipe.weights) == (self._encoder.name, self._encoder.digest)
