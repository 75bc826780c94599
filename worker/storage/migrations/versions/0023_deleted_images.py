"""Images that were deleted while an import into their map waited or ran.

Additive: may run before the new code; the old code never selects the table, and the database clears it with the jobs.
"""

import sqlalchemy as sa
from alembic import op

revision = "0023"
down_revision = "0022"


def upgrade() -> None:
    """Add the table, empty."""
    op.create_table(
        "deleted_images",
        sa.Column("job", sa.BigInteger, sa.ForeignKey("jobs.number", ondelete="CASCADE"), primary_key=True),
        sa.Column("sha256", sa.Text, primary_key=True),
    )
