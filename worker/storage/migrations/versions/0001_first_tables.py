"""The first tables."""

import sqlalchemy as sa
from alembic import op

from worker.storage.columns import UtcDateTime, big_key, ordered_text

revision = "0001"
down_revision = None


def upgrade() -> None:
    """Create all tables, and the row of the clock."""
    op.create_table(
        "clock",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("revision", sa.BigInteger, nullable=False),
    )
    op.execute("INSERT INTO clock (id, revision) VALUES (1, 0)")
    op.create_table(
        "recipes",
        sa.Column("id", sa.Text, primary_key=True),
        sa.Column("body", sa.Text, nullable=False),
    )
    op.create_table(
        "maps",
        sa.Column("id", big_key(), primary_key=True),
        sa.Column("name", ordered_text(), unique=True),
        sa.Column("recipe", sa.Text, sa.ForeignKey("recipes.id"), nullable=False),
        sa.Column("next_recipe", sa.Text, sa.ForeignKey("recipes.id")),
        sa.Column("revision", sa.BigInteger, nullable=False),
        sa.Column("anew", sa.BigInteger, nullable=False),
        sa.Column("created_at", UtcDateTime, nullable=False),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "views",
        sa.Column("seq", big_key(), primary_key=True),
        sa.Column("id", sa.Text, nullable=False, unique=True),
        sa.Column("map_id", sa.BigInteger, sa.ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
        sa.Column("place", ordered_text()),
        sa.Column("x", sa.Double),
        sa.Column("y", sa.Double),
        sa.Column("z", sa.Double),
        sa.Column("lat", sa.Double),
        sa.Column("lon", sa.Double),
        sa.Column("alt", sa.Double),
        sa.Column("heading", sa.Double),
        sa.Column("globe_x", sa.Double),
        sa.Column("globe_y", sa.Double),
        sa.Column("globe_z", sa.Double),
        sa.Column("captured_at", UtcDateTime),
        sa.Column("metadata", sa.Text, nullable=False),
        sa.Column("enrolled_at", UtcDateTime, nullable=False),
        sa.Column("sha256", sa.Text, nullable=False),
        sa.Column("width", sa.Integer, nullable=False),
        sa.Column("height", sa.Integer, nullable=False),
        sa.Column("byte_count", sa.BigInteger, nullable=False),
        sa.Column("format", sa.Text, nullable=False),
        sa.Column("state", sa.Text, nullable=False),
        sa.Column("failure_code", sa.Text),
        sa.Column("failure_detail", sa.Text),
        sa.UniqueConstraint("map_id", "sha256", name="views_once_per_map"),
        sqlite_autoincrement=True,
    )
    op.create_index("views_by_map", "views", ["map_id", "seq"])
    op.create_index("views_by_picture", "views", ["sha256"])
    op.create_index("views_by_place", "views", ["map_id", "place"])
    op.create_index("views_by_capture", "views", ["map_id", "captured_at"])
    op.create_index("views_by_enrolment", "views", ["map_id", "enrolled_at"])
    op.create_index("views_by_metres", "views", ["map_id", "x", "y"])
    op.create_index("views_by_globe", "views", ["map_id", "globe_z", "globe_x", "globe_y"])
    op.create_table(
        "metadata_pairs",
        sa.Column("pair", sa.Text, primary_key=True),
        sa.Column("seq", sa.BigInteger, sa.ForeignKey("views.seq", ondelete="CASCADE"), primary_key=True),
    )
    op.create_index("metadata_pairs_by_view", "metadata_pairs", ["seq"])
    op.create_table(
        "descriptions",
        sa.Column("seq", sa.BigInteger, sa.ForeignKey("views.seq", ondelete="CASCADE"), primary_key=True),
        sa.Column("recipe", sa.Text, sa.ForeignKey("recipes.id"), primary_key=True),
        sa.Column("map_id", sa.BigInteger, nullable=False),
        sa.Column("revision", sa.BigInteger, nullable=False),
        sa.Column("descriptor_count", sa.Integer, nullable=False),
        sa.Column("static_share", sa.Double, nullable=False),
        sa.Column("nodes", sa.Integer, nullable=False),
        sa.Column("label_shares", sa.LargeBinary, nullable=False),
    )
    op.create_index("descriptions_by_revision", "descriptions", ["map_id", "recipe", "revision"])
    for part in ("vectors", "appearances", "keypoints"):
        op.create_table(
            part,
            sa.Column("seq", sa.BigInteger, primary_key=True),
            sa.Column("recipe", sa.Text, primary_key=True),
            sa.Column("body", sa.LargeBinary, nullable=False),
            sa.ForeignKeyConstraint(
                ["seq", "recipe"], ["descriptions.seq", "descriptions.recipe"], name=f"{part}_of", ondelete="CASCADE"
            ),
        )
    op.create_table(
        "jobs",
        sa.Column("number", big_key(), primary_key=True),
        sa.Column("id", sa.Text, nullable=False, unique=True),
        sa.Column("map_id", sa.BigInteger, nullable=False),
        sa.Column("seq", sa.BigInteger, sa.ForeignKey("views.seq", ondelete="CASCADE"), nullable=False),
        sa.Column("recipe", sa.Text, sa.ForeignKey("recipes.id"), nullable=False),
        sa.Column("background", sa.Boolean, nullable=False),
        sa.Column("state", sa.Text, nullable=False),
        sa.Column("attempts", sa.Integer, nullable=False),
        sa.Column("worker", sa.Text),
        sa.Column("token", sa.Text),
        sa.Column("lease_until", UtcDateTime),
        sa.Column("created_at", UtcDateTime, nullable=False),
        sa.Column("finished_at", UtcDateTime),
        sa.Column("failure_code", sa.Text),
        sa.Column("failure_detail", sa.Text),
        sqlite_autoincrement=True,
    )
    op.create_index("jobs_in_order", "jobs", ["state", "background", "number"])
    op.create_index("jobs_by_recipe", "jobs", ["map_id", "recipe", "state"])
    op.create_index("jobs_by_view", "jobs", ["seq", "recipe"])
    op.create_table(
        "tombstones",
        sa.Column("seq", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("map_id", sa.BigInteger, sa.ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
        sa.Column("revision", sa.BigInteger, nullable=False),
    )
    op.create_index("tombstones_by_revision", "tombstones", ["map_id", "revision"])
    op.create_table(
        "vocabularies",
        sa.Column("digest", sa.Text, primary_key=True),
        sa.Column("tensors", sa.LargeBinary, nullable=False),
    )
    op.create_table(
        "calls",
        sa.Column("key", sa.Text, primary_key=True),
        sa.Column("fingerprint", sa.Text, nullable=False),
        sa.Column("begun_at", UtcDateTime, nullable=False),
        sa.Column("finished_at", UtcDateTime),
        sa.Column("status", sa.Integer),
        sa.Column("headers", sa.Text),
        sa.Column("body", sa.LargeBinary),
    )
    op.create_index("calls_by_age", "calls", ["begun_at"])
