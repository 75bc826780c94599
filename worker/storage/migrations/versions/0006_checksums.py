"""Checksums of rows, computed for those there are.

Additive; but the code before does not write checksums, so that rows of its would be taken for damaged: stop it first.
"""

from collections.abc import Mapping
from typing import Any

import sqlalchemy as sa
from alembic import op

from worker.storage.checksums import of_body, of_values
from worker.storage.columns import Body, UtcDateTime

revision = "0006"
down_revision = "0005"

ROWS = 500
"""Rows read at a time."""

BODIES = ("vectors", "appearances", "cells", "keypoints")

# Frozen: keys and covered columns of this revision, in their order.
GIVEN: Mapping[str, tuple[str, str]] = {
    "views": (
        "seq",
        "id map_id place x y z lat lon alt heading globe_x globe_y globe_z captured_at metadata enrolled_at sha256 "
        "width height byte_count format",
    ),
    "descriptions": ("seq recipe", "seq recipe map_id revision descriptor_count static_share nodes label_shares"),
    **dict.fromkeys(BODIES, ("seq recipe", "seq recipe body")),
}
"""Written with the row."""

SEALED: Mapping[str, tuple[str, str]] = {
    "maps": ("id", "name recipe ranking next_recipe next_ranking previous_recipe created_at calibration"),
    "comparisons": ("seq recipe", "seq recipe map_id among others level gap same_spot made_at"),
    "jobs": (
        "number",
        "number id kind map_id seq recipe background state attempts worker token lease_until progress_done "
        "progress_total result created_at finished_at failure_code failure_detail",
    ),
    "tombstones": ("seq", "seq map_id revision"),
    "calls": ("key", "key fingerprint begun_at finished_at status headers body"),
    "clock": ("id", "id revision"),
}
"""Written at the end of the row's transaction."""

TYPES: Mapping[str, sa.types.TypeEngine[Any]] = {
    **dict.fromkeys(
        ("captured_at", "enrolled_at", "created_at", "made_at", "lease_until", "finished_at", "begun_at"), UtcDateTime()
    ),
    **dict.fromkeys(("x", "y", "z", "lat", "lon", "alt", "heading", "globe_x", "globe_y", "globe_z"), sa.Double()),
    **dict.fromkeys(("static_share", "level", "gap"), sa.Double()),
    **dict.fromkeys(("body", "label_shares"), Body()),
    "background": sa.Boolean(),
}


def upgrade() -> None:
    """Add the columns and the indexes of rows without a checksum, then compute."""
    for name in GIVEN:
        op.add_column(name, sa.Column("checksum", sa.BigInteger, nullable=False, server_default="0"))
    for name in SEALED:
        op.add_column(name, sa.Column("checksum", sa.BigInteger))
    connection = op.get_bind()
    for name, (key, columns) in {**GIVEN, **SEALED}.items():
        _fill(connection, name, key.split(), columns.split())
    missing = sa.text("checksum IS NULL")
    for name in SEALED.keys() - {"clock"}:
        first = SEALED[name][0].split()[0]
        op.create_index(f"{name}_unsealed", name, [first], sqlite_where=missing, postgresql_where=missing)


def _fill(connection: sa.Connection, name: str, keys: list[str], columns: list[str]) -> None:
    typed = {c: sa.column(c, TYPES.get(c)) for c in dict.fromkeys([*keys, *columns])}
    table = sa.table(name, *typed.values(), sa.column("checksum", sa.BigInteger))
    setting = (
        sa.update(table)
        .values(checksum=sa.bindparam("seal", type_=sa.BigInteger))
        .where(*(table.c[key] == sa.bindparam(f"of_{key}") for key in keys))
    )
    # Keys first: a cursor must not run over rows that are being changed.
    every = [tuple(row) for row in connection.execute(sa.select(*(table.c[key] for key in keys)))]
    wanted = sa.tuple_(*(table.c[key] for key in keys))
    for start in range(0, len(every), ROWS):
        rows = connection.execute(sa.select(*typed.values()).where(wanted.in_(every[start : start + ROWS])))
        sums = [{"seal": _sum(name, columns, row), **{f"of_{key}": row._mapping[key] for key in keys}} for row in rows]
        connection.execute(setting, sums)


def _sum(name: str, columns: list[str], row: sa.Row[Any]) -> int:
    if name in BODIES:
        return of_body(row.seq, row.recipe, row.body)
    return of_values((column, row._mapping[column]) for column in columns)
