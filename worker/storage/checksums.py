"""Checksums of rows: CRC-32 of the content, kept beside it and compared when it is read.

CRC-32 finds every change of up to 32 consecutive bits, and misses one in 4 billion others. A row is not protected
against an attacker, who could write the checksum too.

Rows written by one statement get their checksum with it (views, descriptions and their parts). In the other tables it
is NULL until the end of the transaction that wrote the row: see `worker.storage.sealing`.
"""

from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from functools import cache
from struct import Struct
from typing import Any
from zlib import crc32

import sqlalchemy as sa

from worker.storage.tables import (
    APPEARANCES,
    CALLS,
    CELLS,
    CLOCK,
    COMPARISONS,
    DAY_SCORES,
    DESCRIPTIONS,
    JOBS,
    KEPT_QUERIES,
    KEYPOINTS,
    KEYS,
    MAPS,
    TOMBSTONES,
    VECTORS,
    VIEWS,
)

BODIES = (VECTORS, APPEARANCES, CELLS, KEYPOINTS)
"""Tables of one body, with a checksum of view, recipe and body."""

_DOUBLE = Struct("<d")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def _but(table: sa.Table, *names: str) -> tuple[str, ...]:
    return tuple(column.name for column in table.columns if column.name not in (*names, "checksum"))


COVERED: Mapping[str, tuple[str, ...]] = {
    # The number is made by the database, the state changes with jobs: both are checked against other rows.
    VIEWS.name: _but(VIEWS, "seq", "state", "failure_code", "failure_detail"),
    DESCRIPTIONS.name: _but(DESCRIPTIONS),
    # Revisions change with every view; they are checked against the clock and the rows that bear them.
    MAPS.name: _but(MAPS, "id", "revision", "anew", "edited", "given_up_at"),
    COMPARISONS.name: _but(COMPARISONS),
    JOBS.name: _but(JOBS),
    TOMBSTONES.name: _but(TOMBSTONES),
    CALLS.name: _but(CALLS),
    KEPT_QUERIES.name: _but(KEPT_QUERIES, "number"),
    DAY_SCORES.name: _but(DAY_SCORES),
    KEYS.name: _but(KEYS),
    CLOCK.name: _but(CLOCK),
    **{table.name: _but(table) for table in BODIES},
}
"""Columns that the checksum of a table's rows covers, in order."""


def of_values(values: Iterable[tuple[str, object]]) -> int:
    """Checksum of a row's columns, as (name, value) in the order of `COVERED`.

    A value is None, int, bool, float, str, bytes or aware datetime; equal ones give equal checksums on every database.
    NULLs are left out: a column that a later version adds changes no checksum while it is empty. A migration that fills
    it, or changes a covered column otherwise, has to compute the checksums anew.
    """
    return crc32(
        b"".join([name.encode() + _ENCODED[type(value)](value) for name, value in values if value is not None])
    )


def of_row(table: sa.Table, row: Mapping[str, Any]) -> int:
    """Checksum of a row of a table; absent columns are NULL."""
    return of_values((name, row.get(name)) for name in COVERED[table.name])


def of_body(seq: int, recipe: str, body: bytes) -> int:
    """Checksum of a part of a description."""
    return crc32(body, crc32(b"%d %b " % (seq, recipe.encode("utf-8", "surrogateescape"))))


def is_whole(table: sa.Table, row: sa.Row[Any]) -> bool:
    """Whether a row that has all columns of a table fits its checksum; None is that of a row just written."""
    mapping = row._mapping
    checksum: object = mapping[table.c.checksum]
    if checksum is None:
        return True
    try:
        return of_values(zip(COVERED[table.name], [mapping[one] for one in _columns(table)], strict=True)) == checksum
    except (OverflowError, UnicodeError):
        return False


def labelled(table: sa.Table, prefix: str) -> list[sa.Label[Any]]:
    """Covered columns of a table and its checksum, as ``prefix_name``, to be selected beside those of another table."""
    return [table.c[name].label(f"{prefix}_{name}") for name in (*COVERED[table.name], "checksum")]


def is_whole_labelled(table: sa.Table, row: Mapping[str, Any] | sa.RowMapping, prefix: str) -> bool:
    """Whether the columns of a table that `labelled` named fit their checksum; `row` has them by these names."""
    try:
        found = of_values(zip(COVERED[table.name], [row[one] for one in _labels(table, prefix)], strict=True))
    except (OverflowError, UnicodeError):
        return False
    return bool(found == row[f"{prefix}_checksum"])


@cache
def _columns(table: sa.Table) -> tuple[sa.Column[Any], ...]:
    """Covered columns; looking each of them up takes longer than all the rest of a checksum."""
    return tuple(table.c[name] for name in COVERED[table.name])


@cache
def _labels(table: sa.Table, prefix: str) -> tuple[str, ...]:
    return tuple(f"{prefix}_{name}" for name in COVERED[table.name])


def _text(value: str) -> bytes:
    text = value.encode("utf-8", "surrogateescape")
    return b"s%d;%b" % (len(text), text)


def _moment(value: datetime) -> bytes:
    since = value.astimezone(UTC) - _EPOCH
    return b"t%d;" % ((since.days * 86400 + since.seconds) * 1_000_000 + since.microseconds)


_ENCODED: Mapping[type, Callable[[Any], bytes]] = {
    bool: lambda value: b"i%d;" % value,
    int: lambda value: b"i%d;" % value,
    float: lambda value: b"d" + _DOUBLE.pack(value + 0.0),  # databases do not keep the sign of zero
    str: _text,
    datetime: _moment,
    bytes: lambda value: b"b%d;%b" % (len(value), value),
}
"""Values as bytes that begin with their type and length, so that no two rows run together alike."""
