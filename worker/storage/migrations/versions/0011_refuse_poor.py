"""Whether a map refuses images that are dark, overexposed, covered or blurred.

Additive: may run before the new code; the old code never selects the column.
"""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"


def upgrade() -> None:
    """Add the column; maps that are there refuse none."""
    op.add_column("maps", sa.Column("refuse_poor", sa.Boolean))
