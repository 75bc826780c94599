"""A table for API keys.

Additive: may run before the new code; the old code never selects the table.
"""

import sqlalchemy as sa
from alembic import op

from worker.storage.columns import UtcDateTime

revision = "0008"
down_revision = "0007"


def upgrade() -> None:
    """Add the table; while it is empty, no caller needs a key."""
    op.create_table(
        "keys",
        sa.Column("id", sa.Text, primary_key=True),
        sa.Column("name", sa.Text, nullable=False),
        sa.Column("digest", sa.LargeBinary, nullable=False),
        sa.Column("scope", sa.Text, nullable=False),
        sa.Column("maps", sa.Text),
        sa.Column("requests_per_minute", sa.Integer),
        sa.Column("images_per_minute", sa.Integer),
        sa.Column("mb_per_minute", sa.Double),
        sa.Column("created_at", UtcDateTime, nullable=False),
        sa.Column("expires_at", UtcDateTime),
        sa.Column("revoked_at", UtcDateTime),
        sa.Column("last_used_at", UtcDateTime),
        sa.Column("checksum", sa.BigInteger),
    )
    missing = sa.text("checksum IS NULL")
    op.create_index("keys_unsealed", "keys", ["id"], sqlite_where=missing, postgresql_where=missing)
