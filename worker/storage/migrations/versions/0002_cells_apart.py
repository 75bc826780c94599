"""Cells at full resolution get a table of their own: re-ranking reads only those at half size of all candidates.

Descriptions and recipes of earlier tables cannot be read any more. No release had them, so a database with maps is
refused rather than converted.
"""

import sqlalchemy as sa
from alembic import op

from schemas.errors import SetupError

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    """Add the table; refuse a database that holds maps."""
    maps = op.get_bind().scalar(sa.text("SELECT count(*) FROM maps"))
    if maps:
        raise SetupError(
            f"the database holds {maps} map(s) of a build before the first release, whose descriptions this version "
            "cannot read; keep that build for them, or start with a new data folder and enrol the images again "
            "(they are in its folder `pictures`)"
        )
    op.execute("DELETE FROM recipes")
    op.create_table(
        "cells",
        sa.Column("seq", sa.BigInteger, primary_key=True),
        sa.Column("recipe", sa.Text, primary_key=True),
        sa.Column("body", sa.LargeBinary, nullable=False),
        sa.ForeignKeyConstraint(
            ["seq", "recipe"], ["descriptions.seq", "descriptions.recipe"], name="cells_of", ondelete="CASCADE"
        ),
    )
