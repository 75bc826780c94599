"""In which order a map kept its queries, whatever the clocks of those who answered them; and signs of life.

Additive: may run before the new code. What is there, and what the old code keeps meanwhile, counts as older than what
the new code keeps, and is ordered by its ids as before.
"""

import sqlalchemy as sa
from alembic import op

revision = "0022"
down_revision = "0021"


def upgrade() -> None:
    """Add the columns, and an index that has all that the order needs."""
    op.add_column("installation", sa.Column("beats", sa.BigInteger, nullable=False, server_default="0"))
    op.add_column("kept_queries", sa.Column("number", sa.BigInteger, nullable=False, server_default="0"))
    op.create_index("kept_queries_in_order", "kept_queries", ["map_id", "number", "id", "seq"])
    op.drop_index("kept_queries_by_map", "kept_queries")
