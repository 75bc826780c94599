"""A table for what views find when their own map is queried with them."""

import sqlalchemy as sa
from alembic import op

from worker.storage.columns import UtcDateTime

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Add the table; it is filled in the background."""
    op.create_table(
        "comparisons",
        sa.Column("seq", sa.BigInteger, primary_key=True),
        sa.Column("recipe", sa.Text, primary_key=True),
        sa.Column("map_id", sa.BigInteger, nullable=False),
        sa.Column("among", sa.Integer, nullable=False),
        sa.Column("others", sa.Integer, nullable=False),
        sa.Column("level", sa.Double),
        sa.Column("gap", sa.Double),
        sa.Column("same_spot", sa.Text, nullable=False),
        sa.Column("made_at", UtcDateTime, nullable=False),
        sa.ForeignKeyConstraint(
            ["seq", "recipe"], ["descriptions.seq", "descriptions.recipe"], name="comparisons_of", ondelete="CASCADE"
        ),
    )
    op.create_index("comparisons_by_map", "comparisons", ["map_id", "recipe"])
