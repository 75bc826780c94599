"""Mean scores of the sure matches of views, day by day.

Additive: may run before the new code; the old code never selects the table, and the database clears it with the views.
"""

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"


def upgrade() -> None:
    """Add the table, empty."""
    op.create_table(
        "day_scores",
        sa.Column("seq", sa.BigInteger, sa.ForeignKey("views.seq", ondelete="CASCADE"), primary_key=True),
        sa.Column("day", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("map_id", sa.BigInteger, nullable=False),
        sa.Column("basis", sa.Text, nullable=False),
        sa.Column("matches", sa.Integer, nullable=False),
        sa.Column("total", sa.Double, nullable=False),
        sa.Column("checksum", sa.BigInteger),
    )
    missing = sa.text("checksum IS NULL")
    op.create_index("day_scores_unsealed", "day_scores", ["seq"], sqlite_where=missing, postgresql_where=missing)
    op.create_index("day_scores_by_map", "day_scores", ["map_id", "day"])
