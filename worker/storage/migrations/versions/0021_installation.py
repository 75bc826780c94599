"""An id of the database, by which the place of its images knows whose they are.

Additive: may run before the new code. That of a database with maps is made of the first one, so that a backup of before
gets the same again.
"""

import uuid

import sqlalchemy as sa
from alembic import op

from worker.storage.columns import UtcDateTime

revision = "0021"
down_revision = "0020"

_MAPS = sa.table("maps", sa.column("id", sa.BigInteger), sa.column("created_at", UtcDateTime))


def upgrade() -> None:
    """Make the table and its row."""
    table = op.create_table("installation", sa.Column("id", sa.Text, primary_key=True))
    first = op.get_bind().execute(sa.select(_MAPS).order_by(_MAPS.c.id).limit(1)).one_or_none()
    own = (
        uuid.uuid4() if first is None else uuid.uuid5(uuid.NAMESPACE_OID, f"{first.id} {first.created_at.isoformat()}")
    )
    op.bulk_insert(table, [{"id": str(own)}])
