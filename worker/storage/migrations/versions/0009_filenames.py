"""Views keep the file name they were sent with.

Additive: may run before the new code; the old code never selects the column. Views of before have none, and so keep
their checksums: these leave out what is NULL.
"""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"


def upgrade() -> None:
    """Add the column."""
    op.add_column("views", sa.Column("filename", sa.Text))
