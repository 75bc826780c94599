"""Which view of another place a view was taken for, and what its own place scored.

Additive: may run before the new code; the old code never selects the columns.
"""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0008"


def upgrade() -> None:
    """Add the columns; comparisons that lack them are made again in the background."""
    op.add_column("comparisons", sa.Column("rival", sa.BigInteger))
    op.add_column("comparisons", sa.Column("own", sa.Double))
