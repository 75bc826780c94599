"""Brings the vectors that PostgreSQL searches up to the descriptions, by revision, whoever wrote those."""

import struct
from typing import Any
from zlib import crc32

import numpy as np
import sqlalchemy as sa

from schemas.recipe import DescriptionRecipe
from worker.storage import dialect
from worker.storage.damage import vectors_size
from worker.storage.database import Database
from worker.storage.packing import unpack_floats
from worker.storage.rows import batches, find_map, find_recipe
from worker.storage.tables import DESCRIPTIONS, VECTORS
from worker.storage.vector_tables import SEARCHED_MAPS, SEARCHED_VECTORS, see_extension

ROWS = 2048
"""Views that one transaction adds at most: the memory that this takes, however large a map is."""

MOST_AGAIN = 20
"""Portions of one call that are added again because views in them were deleted meanwhile."""

FILL = 0x72657669
"""First half of the advisory locks, one for each map, under which a map's vectors are added."""

_COPY = "COPY searched_vectors (searched_id, channel, seq, recipe, vector) FROM STDIN (FORMAT BINARY)"
_HEAD, _END = b"PGCOPY\n\xff\r\n\x00" + bytes(8), b"\xff\xff"

Portion = tuple[list[tuple[int, bytes]], dict[int, str], tuple[int, int] | None]
"""Whole vectors by sequence number, what is damaged, and where the next portion begins; None at the end."""


def follow(database: Database, name: str) -> tuple[str, dict[int, str]]:
    """Add to a map's searched vectors what was described since; those that were deleted are gone by themselves.

    Returns
    -------
    recipe : str
        Id of the map's recipe.
    damaged : dict
        Which views' vectors are damaged and were left out.

    Raises
    ------
    NotFound, DiskFull, StorageFailed
    """
    damaged: dict[int, str] = {}
    after: tuple[int, int] | None = (-1, -1)
    of: tuple[int, str] | None = None
    again = iter(range(MOST_AGAIN))
    while after is not None:
        try:
            with database.writing(in_turn=False, frees=True) as connection:
                own, faults, following = _follow_portion(connection, name, of, after)
        except sa.exc.IntegrityError:  # a view, or the map, was deleted between its reading and its adding
            if next(again, None) is None:
                raise
            continue
        of, after = own, following
        damaged |= faults
    assert of is not None
    return of[1], damaged


def _follow_portion(
    connection: sa.Connection, name: str, of: tuple[int, str] | None, after: tuple[int, int]
) -> tuple[tuple[int, str], dict[int, str], tuple[int, int] | None]:
    """Add one portion; returns the map's number and recipe, what is damaged, and where the next one begins."""
    row = find_map(connection, name)
    connection.execute(sa.text(f"SELECT pg_advisory_xact_lock({FILL}, {int(row.id)})"))
    row = find_map(connection, name)  # as of now that no other process adds to it
    own = int(row.id), str(row.recipe)
    if of != own:  # at first, and when the recipe changed between two portions
        after = (-1, -1)
    held = _held(connection, row)
    if after == (-1, -1) and held.revision is not None and row.anew <= held.revision <= row.revision:
        after = int(held.revision), np.iinfo(np.int64).max
    recipe = find_recipe(connection, row.recipe)
    whole, faults, following = _portion(connection, row, held.id, recipe, after)
    if whole:
        see_extension(connection)
        _add(connection, held.id, recipe, whole)
    if following is None:
        caught_up = sa.update(SEARCHED_MAPS).where(SEARCHED_MAPS.c.id == held.id)
        connection.execute(caught_up.values(revision=row.revision))
    return own, faults, following


def _held(connection: sa.Connection, row: sa.Row[Any]) -> sa.Row[Any]:
    """The row of a map by its present recipe, made when there is none; those of recipes that it left are dropped."""
    own = SEARCHED_MAPS.c.map_id == row.id
    held = connection.execute(sa.select(SEARCHED_MAPS).where(own, SEARCHED_MAPS.c.recipe == row.recipe)).one_or_none()
    if held is not None:
        return held
    left = SEARCHED_MAPS.c.recipe.not_in([row.recipe, row.previous_recipe or row.recipe])
    connection.execute(sa.delete(SEARCHED_MAPS).where(own, left))
    new = sa.insert(SEARCHED_MAPS).values(map_id=row.id, recipe=row.recipe).returning(*SEARCHED_MAPS.c)
    return connection.execute(new).one()


def _portion(
    connection: sa.Connection, row: sa.Row[Any], searched_id: int, recipe: DescriptionRecipe, after: tuple[int, int]
) -> Portion:
    """The next descriptions of a map, by revision, that are not searched yet."""
    # Three plain statements rather than one that joins: a server without statistics of a new map joins the long way.
    order = sa.tuple_(DESCRIPTIONS.c.revision, DESCRIPTIONS.c.seq)
    described = (
        sa.select(DESCRIPTIONS.c.revision, DESCRIPTIONS.c.seq)
        .where(DESCRIPTIONS.c.map_id == row.id, DESCRIPTIONS.c.recipe == row.recipe)
        # No later ones: what is searched is the map as it was at one revision.
        .where(DESCRIPTIONS.c.revision >= after[0], DESCRIPTIONS.c.revision <= row.revision)
        .where(order > sa.tuple_(*(sa.literal(part, sa.BigInteger) for part in after)))
        .order_by(DESCRIPTIONS.c.revision, DESCRIPTIONS.c.seq)
        .limit(ROWS)
    )
    found = list(connection.execute(described))
    last = None if len(found) < ROWS else (int(found[-1].revision), int(found[-1].seq))
    seqs = [int(one.seq) for one in found]
    own = SEARCHED_VECTORS.c.searched_id == searched_id, SEARCHED_VECTORS.c.channel == 0
    there: set[int] = set()
    bodies: list[Any] = []
    for portion in batches(seqs):
        there |= set(
            connection.scalars(sa.select(SEARCHED_VECTORS.c.seq).where(*own, SEARCHED_VECTORS.c.seq.in_(portion)))
        )
        of_recipe = VECTORS.c.recipe == row.recipe, VECTORS.c.seq.in_([seq for seq in portion if seq not in there])
        bodies += connection.execute(sa.select(VECTORS).where(*of_recipe))
    size, of = vectors_size(recipe), row.recipe.encode()
    whole = sorted((int(one.seq), one.body) for one in bodies if _is_whole(one, size, of))
    damaged = dict.fromkeys(set(seqs) - there - {seq for seq, _ in whole}, VECTORS.name)
    return whole, damaged, last


def _is_whole(row: Any, size: int, of: bytes) -> bool:
    """Whether a view's vectors are of the recipe's length, fit their checksum and are numbers."""
    body = row.body
    fits = body is not None and len(body) == size and crc32(body, crc32(b"%d %b " % (row.seq, of))) == row.checksum
    return bool(fits and np.isfinite(unpack_floats(body)).all())


def _add(
    connection: sa.Connection, searched_id: int, recipe: DescriptionRecipe, whole: list[tuple[int, bytes]]
) -> None:
    """Copy vectors into the table, channel by channel, so that those that are compared together lie together."""
    of = recipe.id.encode()
    rows = np.stack([unpack_floats(body) for _, body in whole]).astype(">f4")
    parts, start = [_HEAD], 0
    for number, channel in enumerate(recipe.parameters.channels.values()):
        size = channel.length
        head = struct.pack(">hiqih", 5, 8, searched_id, 2, number)
        # As the extension reads a vector: its length, nothing, then the numbers.
        tail = struct.pack(f">i{len(of)}sihh", len(of), of, 4 + 4 * size, size, 0)
        for (seq, _), row in zip(whole, rows, strict=True):
            parts += (head, struct.pack(">iq", 8, seq), tail, row[start : start + size].tobytes())
        start += size
    with dialect.raw_cursor(connection) as cursor, cursor.copy(_COPY) as copy:
        copy.write(b"".join([*parts, _END]))
