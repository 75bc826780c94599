"""An id of the database, by which the place of its images knows whose they are.

Additive: may run before the new code.
"""

import uuid

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision = "0020"


def upgrade() -> None:
    """Make the table and its row."""
    table = op.create_table("installation", sa.Column("id", sa.Text, primary_key=True))
    op.bulk_insert(table, [{"id": str(uuid.uuid4())}])
