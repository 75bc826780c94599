"""Queries that matched a view although they look unlike it, kept as those that matched nothing are.

Additive: may run before the new code; the old code never selects the columns, and keeps no such queries.
"""

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"


def upgrade() -> None:
    """Add the columns; maps that are there keep no such queries."""
    op.add_column("maps", sa.Column("keep_matches", sa.Integer))
    op.add_column("kept_queries", sa.Column("seq", sa.BigInteger))
    op.add_column("kept_queries", sa.Column("score", sa.Double))
    op.create_index("kept_queries_by_view", "kept_queries", ["seq"])
