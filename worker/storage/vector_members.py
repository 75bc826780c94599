"""Which views of a map are searched in PostgreSQL: their sequence numbers, 8 bytes a view in memory.

A search says how many views it had and how many were enrolled before each that it found. Counting them in the database
would read the whole map for every query.
"""

import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import sqlalchemy as sa

from schemas.records import Sequence64
from worker.storage.rows import batches
from worker.storage.tables import DESCRIPTIONS, TOMBSTONES
from worker.storage.vector_tables import SEARCHED_MAPS, SEARCHED_VECTORS


@dataclass(frozen=True)
class _Known:
    revision: int  # up to which vectors were added
    deleted: int  # up to which deletions were followed
    anew: int
    seqs: Sequence64


class Members:
    """The searched views of each map, brought up to date by revision. Safe to use from several threads."""

    def __init__(self) -> None:
        self._known: dict[int, _Known] = {}
        self._lock = threading.Lock()

    def of(self, connection: sa.Connection, row: sa.Row[Any], searched: sa.Row[Any]) -> Sequence64:
        """The sequence numbers of a map's searched views in a transaction's snapshot, ascending.

        Parameters
        ----------
        connection : Connection
        row
            The row of the map.
        searched
            The row of the map and its recipe in `searched_maps`.
        """
        with self._lock:
            known = self._known.get(searched.id)
        if known is not None and (known.revision > searched.revision or known.deleted > row.revision):
            known = None  # of a later snapshot than that of the transaction
        if known is None or known.anew != row.anew:
            own = SEARCHED_VECTORS.c.searched_id == searched.id, SEARCHED_VECTORS.c.channel == 0
            seqs = np.sort(_array(connection.scalars(sa.select(SEARCHED_VECTORS.c.seq).where(*own))))
        elif (known.revision, known.deleted) == (searched.revision, row.revision):
            return known.seqs
        else:
            later = TOMBSTONES.c.map_id == row.id, TOMBSTONES.c.revision > known.deleted
            gone = _array(connection.scalars(sa.select(TOMBSTONES.c.seq).where(*later)))
            seqs = np.union1d(np.setdiff1d(known.seqs, gone), _added(connection, row.id, searched, known.revision))
        present = None if searched.id in self._known else set(connection.scalars(sa.select(SEARCHED_MAPS.c.id)))
        with self._lock:
            if present is not None:  # drop those of maps that were deleted or have another recipe
                self._known = {one: known for one, known in self._known.items() if one in present}
            self._known[searched.id] = _Known(int(searched.revision), int(row.revision), int(row.anew), seqs)
        return seqs


def _added(connection: sa.Connection, map_id: int, searched: sa.Row[Any], revision: int) -> Sequence64:
    """The searched views that were described since a revision."""
    since = sa.select(DESCRIPTIONS.c.seq).where(
        DESCRIPTIONS.c.map_id == map_id,
        DESCRIPTIONS.c.recipe == searched.recipe,
        DESCRIPTIONS.c.revision > revision,
        DESCRIPTIONS.c.revision <= searched.revision,
    )
    own = SEARCHED_VECTORS.c.searched_id == searched.id, SEARCHED_VECTORS.c.channel == 0
    found: list[int] = []
    for portion in batches(list(connection.scalars(since))):
        there = sa.select(SEARCHED_VECTORS.c.seq).where(*own, SEARCHED_VECTORS.c.seq.in_(portion))
        found += connection.scalars(there)
    return _array(found)


def _array(seqs: Iterable[int]) -> Sequence64:
    return np.fromiter(seqs, np.int64)
