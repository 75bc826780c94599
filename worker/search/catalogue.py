"""One index per map, brought up to date with the store before each search."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime

from schemas.recipe import DescriptionRecipe
from schemas.records import MapRecord
from worker.search.ports import DescriptionReader, Index, MapReader

MakeIndex = Callable[[DescriptionRecipe], Index]


@dataclass(frozen=True)
class _Held:
    index: Index
    made_at: datetime


class Catalogue:
    """Indexes of all maps, built when first needed. A cache of the store.

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
        self._indexes: dict[str, _Held] = {}
        self._locks: dict[str, threading.Lock] = {}
        self._lock = threading.Lock()

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
                # A map that was deleted and created again under its name is another map.
                if (
                    held is None
                    or held.made_at != record.created_at
                    or held.index.recipe != record.description.id
                    or held.index.revision > record.revision  # which never goes back, but by damage or a backup
                ):
                    held = _Held(self._make(record.description), record.created_at)
                if held.index.revision < record.revision:
                    changes = self._descriptions.since(name, held.index.revision)
                    if changes.recipe != held.index.recipe:
                        continue  # the recipe changed between the two reads
                    held.index.apply(changes)
                self._indexes[name] = held
                if held.index.revision > record.revision:
                    continue  # what ranks and calibrates may have changed between the two reads
                return held.index, record

    def revisions(self) -> dict[str, int]:
        """The revision of each loaded index by map; waits for no search."""
        return {name: held.index.revision for name, held in list(self._indexes.items())}

    def recalls(self) -> dict[str, float]:
        """Nothing: every search is exact."""
        return {}

    def forget(self, name: str) -> None:
        """Drop the index of a deleted map."""
        with self._lock:
            self._indexes.pop(name, None)
