"""Over how much of an image the leads of wrong answers hold.

Additive: may run before the new code; the old code never selects the column.
"""

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"


def upgrade() -> None:
    """Add the column; comparisons that lack it are made again in the background."""
    op.add_column("comparisons", sa.Column("breadth", sa.Double))
