"""Gives rows that a transaction wrote their checksum before it commits.

In the tables here the column ``checksum`` becomes NULL with every UPDATE that does not set it, and an index of these
NULLs finds the rows of the transaction.
"""

from functools import cache
from typing import Any

import sqlalchemy as sa

from worker.storage import checksums
from worker.storage.tables import CALLS, CLOCK, COMPARISONS, DAY_SCORES, JOBS, KEPT_QUERIES, KEYS, MAPS, TOMBSTONES

SEALED = (MAPS, COMPARISONS, JOBS, TOMBSTONES, CALLS, CLOCK, KEYS, KEPT_QUERIES, DAY_SCORES)

_KEY = "written_tables"

PORTION = 500
"""Rows sealed together, so that a transaction that wrote a row for each view of a large map needs no memory for all."""


def follow(engine: sa.Engine) -> None:
    """Note, for each connection, which tables its statements write."""

    @sa.event.listens_for(engine, "before_execute")
    def note(connection: sa.Connection, statement: Any, *_: object) -> None:
        if isinstance(statement, sa.Insert | sa.Update) and isinstance(statement.table, sa.Table):
            connection.info.setdefault(_KEY, set()).add(statement.table.name)


def begin(connection: sa.Connection) -> None:
    """Forget what an earlier transaction of the connection wrote."""
    connection.info[_KEY] = set()


def seal(connection: sa.Connection) -> None:
    """Set the checksums of the rows that this transaction wrote."""
    written = set(connection.info.get(_KEY, ()))
    for table in SEALED:
        if table.name in written:
            while _seal_some(connection, table) == PORTION:
                pass


def _seal_some(connection: sa.Connection, table: sa.Table) -> int:
    """Set checksums of at most `PORTION` rows; returns of how many."""
    unsealed, sealing = _statements(table)
    rows = [dict(row._mapping) for row in connection.execute(unsealed, {"most": PORTION})]
    if rows:
        keys = [column.name for column in table.primary_key]
        sums = [{"seal": checksums.of_row(table, row), **{f"of_{key}": row[key] for key in keys}} for row in rows]
        connection.execute(sealing, sums)
    return len(rows)


@cache
def _statements(table: sa.Table) -> tuple[sa.Select[Any], sa.Update]:
    unsealed = sa.select(table).where(table.c.checksum.is_(None)).limit(sa.bindparam("most", type_=sa.Integer))
    sealing = sa.update(table).values(checksum=sa.bindparam("seal", type_=sa.BigInteger))
    return unsealed, sealing.where(*(column == sa.bindparam(f"of_{column.name}") for column in table.primary_key))
