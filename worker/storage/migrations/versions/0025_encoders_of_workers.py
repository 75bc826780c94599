"""Which encoder a worker describes by, so that a service knows whether one can describe what it takes.

Additive: may run before the new code; the old code never selects the column.
"""

import sqlalchemy as sa
from alembic import op

revision = "0025"
down_revision = "0024"


def upgrade() -> None:
    """Add the column; workers of the old code do not say it."""
    op.add_column("workers", sa.Column("encoder", sa.Text))
