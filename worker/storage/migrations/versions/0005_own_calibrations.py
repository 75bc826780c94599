"""A column for the calibration on a map's own labelled queries.

Additive: may run before the new code; the old code never selects the column.
"""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Add the column; NULL for the shipped calibration."""
    op.add_column("maps", sa.Column("calibration", sa.Text))
