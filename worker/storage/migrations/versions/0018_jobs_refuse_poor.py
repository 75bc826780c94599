"""Whether the description of an image may show that it is to be refused.

Additive: may run before the new code; the old code never selects the column.
"""

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"


def upgrade() -> None:
    """Add the column; jobs that wait refuse nothing."""
    op.add_column("jobs", sa.Column("refuse_poor", sa.Boolean))
