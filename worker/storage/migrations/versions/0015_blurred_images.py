"""What a map blurs before it stores an image, and the digest of what was sent in place of a blurred one.

Additive: may run before the new code; the old code never selects the columns. Rows of before have none, and so keep
their checksums: these leave out what is NULL.
"""

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"


def upgrade() -> None:
    """Add the columns; maps that are there store images as they are sent."""
    op.add_column("maps", sa.Column("blur", sa.Text))
    op.add_column("views", sa.Column("sent_sha256", sa.Text))
    sent = sa.text("sent_sha256 IS NOT NULL")
    op.create_index("views_by_sent", "views", ["map_id", "sent_sha256"], sqlite_where=sent, postgresql_where=sent)
