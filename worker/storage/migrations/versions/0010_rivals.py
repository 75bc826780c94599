"""Which view of another place a view was taken for, and what its own place scored; queries that matched nothing.

Additive: may run before the new code; the old code never selects the columns and the table.
"""

import sqlalchemy as sa
from alembic import op

from worker.storage.columns import UtcDateTime

revision = "0010"
down_revision = "0009"


def upgrade() -> None:
    """Add columns and table; comparisons that lack their rival are made again in the background."""
    op.add_column("comparisons", sa.Column("rival", sa.BigInteger))
    op.add_column("comparisons", sa.Column("own", sa.Double))
    op.add_column("maps", sa.Column("keep_queries", sa.Integer))
    op.create_table(
        "kept_queries",
        sa.Column("id", sa.Text, primary_key=True),
        sa.Column("map_id", sa.BigInteger, sa.ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
        sa.Column("recipe", sa.Text, nullable=False),
        sa.Column("queried_at", UtcDateTime, nullable=False),
        sa.Column("vectors", sa.LargeBinary, nullable=False),
        sa.Column("keypoints", sa.LargeBinary),
        sa.Column("image", sa.LargeBinary, nullable=False),
        sa.Column("checksum", sa.BigInteger),
    )
    missing = sa.text("checksum IS NULL")
    op.create_index("kept_queries_unsealed", "kept_queries", ["id"], sqlite_where=missing, postgresql_where=missing)
    op.create_index("kept_queries_by_map", "kept_queries", ["map_id", "id"])
