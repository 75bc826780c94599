"""Searches histogram vectors in PostgreSQL, in one transaction with the map's revision and the filters."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import sqlalchemy as sa

from schemas.description import Floats
from schemas.draw import draw_order
from schemas.recipe import DescriptionRecipe
from schemas.records import MapRecord, Selection, Sequence64, VectorsFound
from worker.storage import vector_filling, vector_tables
from worker.storage.checksums import of_body
from worker.storage.database import Database
from worker.storage.filtering import allowing
from worker.storage.image_store import ImageStore
from worker.storage.listings import selected
from worker.storage.packing import unpack_floats
from worker.storage.part import Part
from worker.storage.rows import batches, find_map, map_record
from worker.storage.tables import DESCRIPTIONS, MAPS, VECTORS, VIEWS
from worker.storage.vector_members import Members
from worker.storage.vector_tables import SEARCHED_MAPS, SEARCHED_VECTORS, Vector, see_extension

SPARE = 8
"""Extra neighbours searched, as in the index in memory, so that ties at the limit are broken by enrolment order."""

EFFORT = 4
"""Entries that HNSW keeps in its search (`ef_search`), as a multiple of the neighbours that are wanted."""

LEAST_EFFORT, MOST_EFFORT = 200, 1000
"""Bounds of `ef_search`; pgvector takes no more."""


@dataclass(frozen=True)
class Scope:
    """The vectors of one channel of a map, and the conditions on the views that may be found."""

    searched_id: int
    channel: int
    size: int
    allowed: Sequence[sa.ColumnElement[bool]]
    on_views: bool  # whether a condition needs the table of views

    def conditions(self) -> tuple[sa.ColumnElement[bool], ...]:
        """All conditions; the first two as literals, as the definition of an HNSW index has them."""
        return (
            sa.literal_column(f"{SEARCHED_VECTORS.name}.searched_id = {int(self.searched_id)}", sa.Boolean),
            sa.literal_column(f"{SEARCHED_VECTORS.name}.channel = {int(self.channel)}", sa.Boolean),
            *self.allowed,
        )

    def select(self, *columns: Any) -> sa.Select[Any]:
        """Columns of these vectors."""
        source: Any = SEARCHED_VECTORS
        if self.on_views:
            source = SEARCHED_VECTORS.join(VIEWS, VIEWS.c.seq == SEARCHED_VECTORS.c.seq)
        return sa.select(*columns).select_from(source).where(*self.conditions())


class VectorSearch(Part):
    """See `worker.search.ports.VectorReader`. Only for a PostgreSQL database that `vector_tables.prepare` prepared."""

    def __init__(self, database: Database, images: ImageStore) -> None:
        super().__init__(database, images)
        self._members = Members()

    def check(self) -> str:
        """``ok``, or what the database lacks to search vectors."""
        with self._database.reading() as connection:
            found = vector_tables.fault(connection)
        return found or "ok"

    def look_up(self, name: str) -> tuple[MapRecord, int, int | None]:
        """A map, its number, and the revision up to which it can be searched, in one snapshot; raises NotFound."""
        with self._database.reading() as connection:
            row = find_map(connection, name)
            searched = searched_row(connection, row.id, row.recipe)
            record = map_record(connection, row)
        revision = None if searched is None else searched.revision
        # A revision before the last change of recipe, or after that of the map (by damage or a backup), is of no use.
        return record, int(row.id), revision if revision is not None and row.anew <= revision <= row.revision else None

    def follow(self, name: str) -> None:
        """Bring a map's searched vectors up to its revision; raises NotFound, DiskFull, StorageFailed."""
        recipe, damaged = vector_filling.follow(self._database, name)
        self._quarantine.descriptions(damaged, recipe)

    def revisions(self) -> dict[str, int]:
        """The revision up to which each map is searched; maps that never were are absent."""
        joined = SEARCHED_MAPS.join(
            MAPS, (MAPS.c.id == SEARCHED_MAPS.c.map_id) & (MAPS.c.recipe == SEARCHED_MAPS.c.recipe)
        )
        known = MAPS.c.name.is_not(None), SEARCHED_MAPS.c.revision.is_not(None)
        with self._database.reading() as connection:
            rows = connection.execute(
                sa.select(MAPS.c.name, SEARCHED_MAPS.c.revision).select_from(joined).where(*known)
            )
            return {row.name: int(row.revision) for row in rows}

    def recalls(self) -> dict[str, float]:
        """The measured recall of each map that HNSW searches."""
        joined = SEARCHED_MAPS.join(
            MAPS, (MAPS.c.id == SEARCHED_MAPS.c.map_id) & (MAPS.c.recipe == SEARCHED_MAPS.c.recipe)
        )
        known = MAPS.c.name.is_not(None), SEARCHED_MAPS.c.recall.is_not(None)
        with self._database.reading() as connection:
            rows = connection.execute(sa.select(MAPS.c.name, SEARCHED_MAPS.c.recall).select_from(joined).where(*known))
            return {row.name: float(row.recall) for row in rows}

    def sample(self, map_id: int, recipe: str, count: int) -> list[int]:
        """Up to `count` views of a map described by a recipe: the first in the order of `schemas.draw`."""
        of = DESCRIPTIONS.c.map_id == map_id, DESCRIPTIONS.c.recipe == recipe
        with self._database.reading() as connection:
            drawn = sa.select(DESCRIPTIONS.c.seq).where(*of).order_by(draw_order(DESCRIPTIONS.c.seq)).limit(count)
            return [int(seq) for seq in connection.scalars(drawn)]

    def nearest(
        self,
        name: str,
        map_id: int,
        recipe: DescriptionRecipe,
        vectors: Mapping[str, Floats],
        count: int,
        selection: Selection,
        *,
        least: int,
        approximate: bool,
    ) -> VectorsFound | None:
        """The nearest views of a map by each channel, with their vectors, all as of one revision.

        Parameters
        ----------
        name : str
        map_id : int
            The map's number, as `look_up` gave it.
        recipe : DescriptionRecipe
        vectors : mapping of channel to float32 of shape (dimensions,)
        count : int
            Views of each channel; some more are returned, for ties.
        selection : Selection
        least : int
            The oldest revision that may be searched.
        approximate : bool
            Whether HNSW may be used, where there is such an index.

        Returns
        -------
        VectorsFound or None
            None when the map is another one by now, or its vectors by this recipe are gone.

        Raises
        ------
        NotFound, InvalidParameters
        """
        never = selection.never
        while True:
            with self._database.reading() as connection:
                row = find_map(connection, name)
                searched = None if row.id != map_id else searched_row(connection, map_id, recipe.id)
                if searched is None or searched.revision is None or searched.revision < least:
                    return None
                members = self._members.of(connection, row, searched)
                chosen = self._chosen(connection, map_id, selection, never)
                available = _count(members, chosen)
                wanted = min(count + SPARE, available)
                see_extension(connection)
                found = [
                    nearest(connection, scope, vectors[channel], wanted, approximate=approximate)
                    for channel, scope in self._scopes(connection, searched.id, map_id, recipe, selection, chosen)
                    if channel in vectors
                ]
                union = np.unique(np.concatenate([np.zeros(0, np.int64), *found]))
                bodies, damaged = stored_vectors(connection, union, recipe.id)
            if not damaged:
                rows = np.stack(bodies) if bodies else np.zeros((0, 0), np.float32)
                order = np.searchsorted(members, union).astype(np.int64)
                return VectorsFound(int(searched.revision), available, union, rows, order)
            self._quarantine.descriptions(dict.fromkeys(damaged, VECTORS.name), recipe.id)
            never = np.union1d(never, np.array(damaged, np.int64))

    def _chosen(self, connection: sa.Connection, map_id: int, selection: Selection, never: Sequence64) -> Selection:
        """A selection with its filters as sequence numbers, for counting; raises InvalidParameters."""
        if selection.filters is None:
            return Selection(selection.only, never)
        of_filters = selected(connection, map_id, selection.filters)
        return Selection(of_filters.only, np.union1d(of_filters.never, never))

    def _scopes(
        self,
        connection: sa.Connection,
        searched_id: int,
        map_id: int,
        recipe: DescriptionRecipe,
        selection: Selection,
        chosen: Selection,
    ) -> Iterator[tuple[str, Scope]]:
        """Each channel with its scope. The filters of a selection become conditions on the table of views."""
        conditions: list[sa.ColumnElement[bool]] = []
        if selection.filters is not None and chosen.only is not None:
            conditions += allowing(connection, selection.filters, [VIEWS.c.map_id == map_id])
        elif chosen.only is not None:
            conditions.append(SEARCHED_VECTORS.c.seq == sa.func.any(_array(chosen.only)))
        on_views = selection.filters is not None and bool(conditions)
        if len(chosen.never):
            conditions.append(SEARCHED_VECTORS.c.seq != sa.func.all(_array(chosen.never)))
        for number, (name, channel) in enumerate(recipe.parameters.channels.items()):
            yield name, Scope(searched_id, number, channel.length, conditions, on_views)


def nearest(connection: sa.Connection, scope: Scope, vector: Floats, wanted: int, *, approximate: bool) -> Sequence64:
    """Sequence numbers of the `wanted` nearest vectors, nearest first; exact unless `approximate` found enough."""
    if wanted == 0:
        return np.zeros(0, np.int64)
    seq = SEARCHED_VECTORS.c.seq
    text = sa.literal("[" + ",".join(repr(float(value)) for value in vector) + "]", sa.Text)
    if approximate:
        effort = min(MOST_EFFORT, max(LEAST_EFFORT, EFFORT * wanted))
        connection.execute(_HNSW, {"effort": str(effort)})
        # The cast is that of the index, so that it is used; without it, it is not.
        sized = Vector(scope.size)
        distance = sa.cast(SEARCHED_VECTORS.c.vector, sized).op("<->")(sa.cast(text, sized))
        near = list(connection.scalars(scope.select(seq).order_by(distance).limit(wanted)))
        if len(near) == wanted:
            return np.array(near, np.int64)
    exact = SEARCHED_VECTORS.c.vector.op("<->")(sa.cast(text, Vector()))
    return np.array(list(connection.scalars(scope.select(seq).order_by(exact, seq).limit(wanted))), np.int64)


_HNSW = sa.text(
    "SELECT set_config('hnsw.ef_search', :effort, true), set_config('hnsw.iterative_scan', 'strict_order', true)"
)


def searched_row(connection: sa.Connection, map_id: int, recipe: str) -> sa.Row[Any] | None:
    """The row of a map and a recipe in `searched_maps`; None before it was searched."""
    own = SEARCHED_MAPS.c.map_id == map_id, SEARCHED_MAPS.c.recipe == recipe
    return connection.execute(sa.select(SEARCHED_MAPS).where(*own)).one_or_none()


def _count(members: Sequence64, chosen: Selection) -> int:
    """How many of the searched views a selection allows."""
    allowed = members if chosen.only is None else np.intersect1d(members, chosen.only, assume_unique=True)
    return len(allowed) - len(np.intersect1d(allowed, chosen.never, assume_unique=True))


def stored_vectors(
    connection: sa.Connection, seqs: Sequence64, recipe: str
) -> tuple[list[npt.NDArray[np.float32]], list[int]]:
    """Vectors of views, in their order, from the table of descriptions; and the views whose vectors are damaged."""
    found: dict[int, npt.NDArray[np.float32]] = {}
    for portion in batches(int(seq) for seq in seqs):
        reading = sa.select(VECTORS).where(VECTORS.c.seq.in_(portion), VECTORS.c.recipe == recipe)
        for row in connection.execute(reading):
            if of_body(row.seq, recipe, row.body) == row.checksum:
                found[row.seq] = unpack_floats(row.body)
    return [found[int(seq)] for seq in seqs if int(seq) in found], [int(seq) for seq in seqs if int(seq) not in found]


def _array(seqs: Sequence64) -> sa.ColumnElement[Any]:
    """Numbers as one parameter."""
    return sa.cast(sa.literal("{" + ",".join(map(str, seqs.tolist())) + "}", sa.Text), sa.ARRAY(sa.BigInteger))
