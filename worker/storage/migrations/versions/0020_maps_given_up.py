"""From when on a map without a name belongs to nobody: whoever deletes or restores it was killed.

Additive: may run before the new code. What the old code leaves without a name is removed when a service starts alone,
as before.
"""

import sqlalchemy as sa
from alembic import op

from worker.storage.columns import UtcDateTime

revision = "0020"
down_revision = "0019"


def upgrade() -> None:
    """Add the column."""
    op.add_column("maps", sa.Column("given_up_at", UtcDateTime))
