"""From which revision on the attributes of a map's views are those that they are.

Additive: may run before the new code. The old code never writes the column, so that attributes which it changes while
the new code runs beside it may be filtered by as they were, for ten minutes at most (`filter_cache.KEPT_S`).
"""

import sqlalchemy as sa
from alembic import op

revision = "0019"
down_revision = "0018"


def upgrade() -> None:
    """Add the column; what is in memory begins after it."""
    op.add_column("maps", sa.Column("edited", sa.BigInteger, nullable=False, server_default="0"))
