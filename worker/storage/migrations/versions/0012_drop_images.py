"""Whether a map removes images once they are described.

Additive: may run before the new code; the old code never selects the column.
"""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"


def upgrade() -> None:
    """Add the column; maps that are there keep their images."""
    op.add_column("maps", sa.Column("drop_images", sa.Boolean))
