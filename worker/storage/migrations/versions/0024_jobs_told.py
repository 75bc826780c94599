"""Whether a further call was told of a view before its enrolment ended.

Additive: may run before the new code; the old code never selects the column.
"""

import sqlalchemy as sa
from alembic import op

revision = "0024"
down_revision = "0023"


def upgrade() -> None:
    """Add the column; of jobs that wait nobody is known to have been told."""
    op.add_column("jobs", sa.Column("told", sa.Boolean))
