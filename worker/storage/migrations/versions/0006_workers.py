"""Signs of life of workers, and the time that passed between enrolments.

Additive but for an index: may run before the new code; the old code never selects the table and the column.
"""

from datetime import timedelta

import sqlalchemy as sa
from alembic import op

from worker.storage.columns import UtcDateTime

revision = "0006"
down_revision = "0005"

_VIEWS = sa.table(
    "views", sa.column("seq", sa.BigInteger), sa.column("enrolled_at", UtcDateTime), sa.column("elapsed_us")
)


def upgrade() -> None:
    """Add the table and the column; the time between views that are there is the difference of their times."""
    op.create_table(
        "workers",
        sa.Column("name", sa.Text, primary_key=True),
        sa.Column("kind", sa.Text, nullable=False),
        sa.Column("host", sa.Text, nullable=False),
        sa.Column("pid", sa.Integer, nullable=False),
        sa.Column("started_at", UtcDateTime, nullable=False),
        sa.Column("seen_at", UtcDateTime, nullable=False),
        sa.Column("beats", sa.BigInteger, nullable=False),
    )
    op.add_column("views", sa.Column("elapsed_us", sa.BigInteger, nullable=False, server_default="0"))
    _measure(op.get_bind())
    op.drop_index("views_by_enrolment", table_name="views")
    op.create_index("views_by_elapsed", "views", ["map_id", "elapsed_us"])


def _measure(connection: sa.Connection) -> None:
    enrolled = list(connection.execute(sa.select(_VIEWS.c.seq, _VIEWS.c.enrolled_at).order_by(_VIEWS.c.seq)))
    elapsed, values = 0, []
    for before, row in zip([*enrolled[:1], *enrolled], enrolled, strict=False):
        elapsed += max(0, (row.enrolled_at - before.enrolled_at) // timedelta(microseconds=1))
        values.append({"of": row.seq, "elapsed": elapsed})
    if values:
        given = sa.update(_VIEWS).where(_VIEWS.c.seq == sa.bindparam("of"))
        connection.execute(given.values(elapsed_us=sa.bindparam("elapsed")), values)
