"""A map may have a shadow: a recipe that its views are described by, and that it changes over to only when told.

Additive: the old code never selects the column. It would end a shadow by changing over to it: no shadow is begun while
workers of the version before run.
"""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"


def upgrade() -> None:
    """Add the column; no map that is there has a shadow."""
    op.add_column("maps", sa.Column("shadow", sa.Text))
