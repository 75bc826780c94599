"""One index per map, brought up to date with the store before each search."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from schemas.errors import NotFound
from schemas.recipe import DescriptionRecipe
from schemas.records import MapRecord
from worker.method.camera_fixed import CameraFixed
from worker.search.fixed_cells import FixedCells
from worker.search.ports import DescriptionReader, Index, MapReader, SearchableIndex

MakeIndex = Callable[[DescriptionRecipe], Index]

log = logging.getLogger("revisit")

PREPARE_S = 2.0
"""Seconds after which the prepared index of a map that is changing gets what was described by the new recipe since."""

KEPT_S = 60.0
"""Seconds for which a prepared index is kept when its map is not, or no longer, changing to that recipe."""


@dataclass
class _Held:
    """An index of the map with this number.

    `read_at` is when it was last brought up to date, by the monotonic clock, if it is prepared ahead of a change.
    """

    index: Index
    number: int
    read_at: float = 0.0

    def is_of(self, record: MapRecord, recipe: str) -> bool:
        """Whether it is of this map and this recipe. A map that was made or restored under the same name is another."""
        return self.number == record.number and self.index.recipe == recipe


class Catalogue:
    """Indexes of all maps, built when first needed. A cache of the store.

    While a map is being described by another recipe, the index by that recipe is prepared in a thread of its own, so
    that the first query after the change does not wait for it.

    Parameters
    ----------
    maps, descriptions
        Parts of the store.
    make : function
        Description recipe to an empty index.
    """

    def __init__(self, maps: MapReader, descriptions: DescriptionReader, make: MakeIndex) -> None:
        self._maps, self._descriptions = maps, descriptions
        self._make = make
        self._fixed = FixedCells(descriptions)
        self._indexes: dict[str, _Held] = {}
        self._locks: dict[str, threading.Lock] = {}
        self._lock = threading.Lock()
        self._prepared: dict[str, _Held] = {}
        self._preparing = threading.Lock()
        self._thread: threading.Thread | None = None

    def index(self, name: str) -> tuple[Index, MapRecord]:
        """The index of a map, with all changes committed before this call, and the map at that revision.

        Raises
        ------
        NotFound
            There is no such map.
        """
        with self._lock:
            lock = self._locks.setdefault(name, threading.Lock())
        with lock:
            while True:
                record = self._maps.get(name)
                held = self._indexes.get(name)
                if (
                    held is None
                    or not held.is_of(record, record.description.id)
                    or held.index.revision > record.revision  # which never goes back, but by damage or a backup
                ):
                    held = self._take_prepared(name, record) or _Held(self._make(record.description), record.number)
                    self._forget_deleted()
                if held.index.revision < record.revision:
                    changes = self._descriptions.since(name, held.index.revision)
                    if changes.recipe != held.index.recipe:
                        continue  # the recipe changed between the two reads
                    held.index.apply(changes)
                self._indexes[name] = held
                if held.index.revision > record.revision:
                    continue  # what ranks and calibrates may have changed between the two reads
                self._look_ahead(record)
                return held.index, record

    def camera_fixed(self, index: SearchableIndex, recipe: DescriptionRecipe) -> CameraFixed | None:
        """What is fixed to the camera that took the views of an index, which are described by the recipe, or None."""
        return self._fixed.of(index.sample(), recipe)

    def prepare(self, name: str, recipe: DescriptionRecipe) -> None:
        """Prepare the index of a map by a recipe that it is about to change to, so that no query has to read it.

        Raises
        ------
        NotFound
            There is no such map.
        """
        with self._preparing:
            record = self._maps.get(name)
            if record.description.id == recipe.id:
                return
            known = self._prepared.get(name)
            if known is None or not known.is_of(record, recipe.id):
                known = _Held(self._make(recipe), record.number)
            changes = self._descriptions.since(name, known.index.revision, recipe)
            known.index.apply(changes)
            known.read_at = time.monotonic()
            self._prepared[name] = known

    def close(self) -> None:
        """Wait for what reads in the background."""
        with self._lock:
            thread = self._thread
        if thread is not None:
            thread.join()

    def _take_prepared(self, name: str, record: MapRecord) -> _Held | None:
        """The index that was prepared for the recipe that a map has changed over to, brought up to date; else None."""
        if name not in self._prepared:
            return None
        with self._preparing:
            known = self._prepared.pop(name, None)
            if known is None or not known.is_of(record, record.description.id):
                return None
            known.index.apply(self._descriptions.since(name, known.index.revision, record.description))
            if len(known.index) != self._descriptions.count_described(name, record.description.id):
                return None  # a worker of an earlier version described some of them under an older revision
            return known

    def _look_ahead(self, record: MapRecord) -> None:
        """Begin to prepare the next index of a map that is changing, unless that was done a moment ago.

        A prepared index that is no longer needed is dropped.
        """
        known, now = self._prepared.get(record.name), time.monotonic()
        changing = record.following is not None and record.shadow is None
        if not changing:  # kept for a while: `prepare` may have been called for a change that begins now
            if known is not None and now - known.read_at > KEPT_S:
                self._prepared.pop(record.name, None)
            return
        with self._lock:
            if self._thread is not None or (known is not None and now - known.read_at < PREPARE_S):
                return
            self._thread = threading.Thread(
                target=self._prepare_apart, args=(record.name, record.following), name="revisit-index", daemon=True
            )
            self._thread.start()

    def _prepare_apart(self, name: str, recipe: str) -> None:
        try:
            self.prepare(name, self._maps.description(recipe))
        except NotFound:
            log.info("map %s was deleted while its next index was read", name)
        except Exception as error:  # the query after the change reads it, and says what is wrong
            log.warning("the index that map %s changes to is not read ahead: %s", name, error)
        finally:
            self._thread = None

    def revisions(self) -> dict[str, int]:
        """The revision of each loaded index by map; waits for no search."""
        return {name: held.index.revision for name, held in list(self._indexes.items())}

    def recalls(self) -> dict[str, float]:
        """Nothing: every search is exact."""
        return {}

    def _forget_deleted(self) -> None:
        """Drop the indexes of maps that another process deleted, of which this one is not notified."""
        present = self._maps.numbers()
        with self._lock:
            for indexes in (self._indexes, self._prepared):
                for name in [name for name, held in indexes.items() if held.number not in present]:
                    indexes.pop(name, None)

    def forget(self, name: str) -> None:
        """Drop the indexes of a deleted map."""
        with self._lock:
            self._indexes.pop(name, None)
            self._prepared.pop(name, None)
