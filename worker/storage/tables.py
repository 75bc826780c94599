"""The tables, in SQLAlchemy Core; `migrations` creates exactly these.

::

    clock                      the last revision
    recipes                    description recipes by id
    maps                       ── views ── descriptions ── vectors, appearances, cells, keypoints, comparisons
                                    ├───── metadata_pairs, day_scores
                                    └───── jobs ── deleted_images
                               ── tombstones, kept_queries
    vocabularies    calls    keys    workers      without references

Dependent rows are deleted with their row (ON DELETE CASCADE). The wide columns of a description have tables of their
own, since each is read alone and rows with overflow pages are slow to scan.
"""

import sqlalchemy as sa

from worker.storage.columns import Body, UtcDateTime, big_key, ordered_text

METADATA = sa.MetaData()


def _checksum() -> sa.Column[int]:
    """CRC-32 of the row's content, given when it is written: see checksums.py."""
    return sa.Column("checksum", sa.BigInteger, nullable=False, server_default="0")


def _seal() -> sa.Column[int | None]:
    """CRC-32 of the row's content; NULL until its transaction ends: see sealing.py."""
    return sa.Column("checksum", sa.BigInteger, onupdate=sa.null())


def _unsealed(table: str, key: str) -> sa.Index:
    missing = sa.text("checksum IS NULL")
    return sa.Index(f"{table}_unsealed", key, sqlite_where=missing, postgresql_where=missing)


CLOCK = sa.Table(
    "clock",
    METADATA,
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),  # one row, 1
    sa.Column("revision", sa.BigInteger, nullable=False),
    _seal(),
)

INSTALLATION = sa.Table(
    "installation",
    METADATA,
    sa.Column("id", sa.Text, primary_key=True),  # one row: by which the place of the images knows whose they are
    sa.Column("beats", sa.BigInteger, nullable=False, server_default="0"),  # signs of life that were given: signs.py
)

RECIPES = sa.Table(
    "recipes",
    METADATA,
    sa.Column("id", sa.Text, primary_key=True),
    sa.Column("body", sa.Text, nullable=False),  # JSON
)

MAPS = sa.Table(
    "maps",
    METADATA,
    sa.Column("id", big_key(), primary_key=True),
    sa.Column("name", ordered_text(), unique=True),  # NULL while it is being deleted
    sa.Column("recipe", sa.Text, sa.ForeignKey("recipes.id"), nullable=False),
    sa.Column("ranking", sa.Text, nullable=False, server_default="{}"),  # JSON
    sa.Column("next_recipe", sa.Text, sa.ForeignKey("recipes.id")),  # during a recipe switch
    sa.Column("next_ranking", sa.Text),  # JSON, with next_recipe
    sa.Column("previous_recipe", sa.Text),  # its descriptions are kept, for switching back
    sa.Column("revision", sa.BigInteger, nullable=False),
    sa.Column("anew", sa.BigInteger, nullable=False),  # an index older than this revision is rebuilt
    sa.Column("edited", sa.BigInteger, nullable=False, server_default="0"),  # since when its views' attributes stand
    sa.Column("created_at", UtcDateTime, nullable=False),
    sa.Column("calibration", sa.Text),  # JSON; NULL: the shipped one
    sa.Column("keep_queries", sa.Integer),  # how many queries that matched nothing are kept at most; NULL: none
    sa.Column("keep_matches", sa.Integer),  # and how many that matched a view although they look unlike it
    sa.Column("refuse_poor", sa.Boolean),  # whether poor images are refused; NULL: no
    sa.Column("drop_images", sa.Boolean),  # whether images are removed once they are described; NULL: no
    sa.Column("shadow", sa.Text),  # id of the job of its shadow: next_recipe waits to be told; NULL: none
    sa.Column("blur", sa.Text),  # JSON: words whose cells are covered before an image is stored; NULL: none
    sa.Column("given_up_at", UtcDateTime),  # without a name: from when on nobody is at work on it
    _seal(),
    _unsealed("maps", "id"),
    sqlite_autoincrement=True,
)

VIEWS = sa.Table(
    "views",
    METADATA,
    sa.Column("seq", big_key(), primary_key=True),  # never used twice: the id in indexes
    sa.Column("id", sa.Text, nullable=False, unique=True),
    sa.Column("map_id", sa.BigInteger, sa.ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
    sa.Column("place", ordered_text()),
    sa.Column("x", sa.Double),  # metres
    sa.Column("y", sa.Double),
    sa.Column("z", sa.Double),
    sa.Column("lat", sa.Double),  # degrees
    sa.Column("lon", sa.Double),
    sa.Column("alt", sa.Double),  # metres
    sa.Column("heading", sa.Double),  # degrees
    sa.Column("globe_x", sa.Double),  # lat and lon as a point on the unit sphere: see filtering.py
    sa.Column("globe_y", sa.Double),
    sa.Column("globe_z", sa.Double),
    sa.Column("captured_at", UtcDateTime),
    sa.Column("metadata", sa.Text, nullable=False),  # JSON
    sa.Column("filename", sa.Text),  # last part of the name the image was sent with
    sa.Column("enrolled_at", UtcDateTime, nullable=False),
    sa.Column("sha256", sa.Text, nullable=False),
    sa.Column("width", sa.Integer, nullable=False),
    sa.Column("height", sa.Integer, nullable=False),
    sa.Column("byte_count", sa.BigInteger, nullable=False),
    sa.Column("format", sa.Text, nullable=False),
    sa.Column("state", sa.Text, nullable=False),  # pending, ready or failed, by the map's recipe
    sa.Column("failure_code", sa.Text),
    sa.Column("failure_detail", sa.Text),
    sa.Column("elapsed_us", sa.BigInteger, nullable=False, server_default="0"),  # see enrolment_order.py
    sa.Column("sent_sha256", sa.Text),  # of what was sent, where a blurred image is stored in its place
    _checksum(),
    sa.UniqueConstraint("map_id", "sha256", name="views_once_per_map"),
    sa.Index("views_by_map", "map_id", "seq"),
    sa.Index("views_by_picture", "sha256"),
    sa.Index(
        "views_by_sent",
        "map_id",
        "sent_sha256",
        sqlite_where=sa.text("sent_sha256 IS NOT NULL"),
        postgresql_where=sa.text("sent_sha256 IS NOT NULL"),
    ),
    sa.Index("views_by_place", "map_id", "place"),
    sa.Index("views_by_capture", "map_id", "captured_at"),
    sa.Index("views_by_elapsed", "map_id", "elapsed_us"),
    sa.Index("views_by_metres", "map_id", "x", "y"),
    sa.Index("views_by_globe", "map_id", "globe_z", "globe_x", "globe_y"),
    sqlite_autoincrement=True,
)

METADATA_PAIRS = sa.Table(
    "metadata_pairs",
    METADATA,
    sa.Column("pair", sa.Text, primary_key=True),  # SHA-256 of key and value: values may be too long for an index
    sa.Column("seq", sa.BigInteger, sa.ForeignKey("views.seq", ondelete="CASCADE"), primary_key=True),
    sa.Index("metadata_pairs_by_view", "seq"),
)

DESCRIPTIONS = sa.Table(
    "descriptions",
    METADATA,
    sa.Column("seq", sa.BigInteger, sa.ForeignKey("views.seq", ondelete="CASCADE"), primary_key=True),
    sa.Column("recipe", sa.Text, sa.ForeignKey("recipes.id"), primary_key=True),
    sa.Column("map_id", sa.BigInteger, nullable=False),  # of the view, for the index below
    sa.Column("revision", sa.BigInteger, nullable=False),
    sa.Column("descriptor_count", sa.Integer, nullable=False),
    sa.Column("static_share", sa.Double, nullable=False),
    sa.Column("nodes", sa.Integer, nullable=False),
    sa.Column("label_shares", Body, nullable=False),  # float32, little-endian
    _checksum(),
    sa.Index("descriptions_by_revision", "map_id", "recipe", "revision"),
)


def _part_of_a_description(name: str) -> sa.Table:
    return sa.Table(
        name,
        METADATA,
        sa.Column("seq", sa.BigInteger, primary_key=True),
        sa.Column("recipe", sa.Text, primary_key=True),
        sa.Column("body", Body, nullable=False),
        _checksum(),
        sa.ForeignKeyConstraint(
            ["seq", "recipe"], ["descriptions.seq", "descriptions.recipe"], name=f"{name}_of", ondelete="CASCADE"
        ),
    )


VECTORS = _part_of_a_description("vectors")  # float32, little-endian, channels concatenated
APPEARANCES = _part_of_a_description("appearances")  # this and the following: see packing.py
CELLS = _part_of_a_description("cells")
KEYPOINTS = _part_of_a_description("keypoints")

COMPARISONS = sa.Table(  # of a view with the other views of its map; see schemas.comparisons.Comparison
    "comparisons",
    METADATA,
    sa.Column("seq", sa.BigInteger, primary_key=True),
    sa.Column("recipe", sa.Text, primary_key=True),
    sa.Column("map_id", sa.BigInteger, nullable=False),  # of the view, for the index below
    sa.Column("among", sa.Integer, nullable=False),
    sa.Column("others", sa.Integer, nullable=False),
    sa.Column("level", sa.Double),
    sa.Column("gap", sa.Double),
    sa.Column("same_spot", sa.Text, nullable=False),  # JSON: sequence numbers
    sa.Column("rival", sa.BigInteger),  # sequence number of the view with the score `level`
    sa.Column("own", sa.Double),
    sa.Column("breadth", sa.Double),
    sa.Column("made_at", UtcDateTime, nullable=False),
    _seal(),
    sa.ForeignKeyConstraint(
        ["seq", "recipe"], ["descriptions.seq", "descriptions.recipe"], name="comparisons_of", ondelete="CASCADE"
    ),
    sa.Index("comparisons_by_map", "map_id", "recipe"),
    _unsealed("comparisons", "seq"),
)

JOBS = sa.Table(
    "jobs",
    METADATA,
    sa.Column("number", big_key(), primary_key=True),  # in queueing order
    sa.Column("id", sa.Text, nullable=False, unique=True),
    sa.Column(
        "kind", sa.Text, nullable=False
    ),  # describe (a view); recipe, shadow, vocabulary, snapshot, import (a map)
    sa.Column("map_id", sa.BigInteger, nullable=False),
    sa.Column("seq", sa.BigInteger, sa.ForeignKey("views.seq", ondelete="CASCADE")),  # NULL for a job of a map
    sa.Column("recipe", sa.Text, sa.ForeignKey("recipes.id")),  # NULL before training has ended, and of a snapshot
    sa.Column("background", sa.Boolean, nullable=False),  # of a recipe switch; enrolments go first
    sa.Column("state", sa.Text, nullable=False),
    sa.Column("attempts", sa.Integer, nullable=False),
    sa.Column("worker", sa.Text),
    sa.Column("token", sa.Text),
    sa.Column("lease_until", UtcDateTime),  # of versions before signs of life; NULL since
    sa.Column("progress_done", sa.Integer),  # of training and importing; describing is counted in jobs
    sa.Column("progress_total", sa.Integer),
    sa.Column("result", sa.Text),  # JSON
    sa.Column("created_at", UtcDateTime, nullable=False),
    sa.Column("finished_at", UtcDateTime),
    sa.Column("failure_code", sa.Text),
    sa.Column("failure_detail", sa.Text),
    sa.Column("refuse_poor", sa.Boolean),  # of an enrolment: whether a description that shows a poor image fails it
    sa.Column("told", sa.Boolean),  # of an enrolment: whether a further call was told of the view, which then stays
    _seal(),
    _unsealed("jobs", "number"),
    sa.Index("jobs_in_order", "kind", "state", "background", "number"),
    sa.Index("jobs_by_recipe", "map_id", "recipe", "state"),
    sa.Index("jobs_by_view", "seq", "recipe"),
    sqlite_autoincrement=True,
)

DELETED_IMAGES = sa.Table(  # while an import into their map waited or ran; see deleted_images.py
    "deleted_images",
    METADATA,
    sa.Column("job", sa.BigInteger, sa.ForeignKey("jobs.number", ondelete="CASCADE"), primary_key=True),
    sa.Column("sha256", sa.Text, primary_key=True),  # of what was sent or stored
)

TOMBSTONES = sa.Table(
    "tombstones",
    METADATA,
    sa.Column("seq", sa.BigInteger, primary_key=True, autoincrement=False),
    sa.Column("map_id", sa.BigInteger, sa.ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
    sa.Column("revision", sa.BigInteger, nullable=False),
    _seal(),
    _unsealed("tombstones", "seq"),
    sa.Index("tombstones_by_revision", "map_id", "revision"),
)

KEPT_QUERIES = sa.Table(  # queries that matched nothing, or a view that they look unlike; see kept_queries.py
    "kept_queries",
    METADATA,
    sa.Column("id", sa.Text, primary_key=True),  # of the query
    sa.Column("map_id", sa.BigInteger, sa.ForeignKey("maps.id", ondelete="CASCADE"), nullable=False),
    sa.Column("recipe", sa.Text, nullable=False),  # of the description
    sa.Column("queried_at", UtcDateTime, nullable=False),
    sa.Column("vectors", Body, nullable=False),  # as those of views
    sa.Column("keypoints", Body),
    sa.Column("image", Body, nullable=False),  # JPEG, small
    sa.Column("seq", sa.BigInteger),  # the view that it matched, with which it is deleted; NULL: none
    sa.Column("score", sa.Double),  # of the match
    sa.Column("number", sa.BigInteger, nullable=False, server_default="0"),  # in the order in which its map kept them
    _seal(),
    _unsealed("kept_queries", "id"),
    sa.Index("kept_queries_in_order", "map_id", "number", "id", "seq"),  # the oldest are found without reading rows
    sa.Index("kept_queries_by_view", "seq"),
)

DAY_SCORES = sa.Table(  # sure matches of a view on one day; see day_scores.py
    "day_scores",
    METADATA,
    sa.Column("seq", sa.BigInteger, sa.ForeignKey("views.seq", ondelete="CASCADE"), primary_key=True),
    sa.Column("day", sa.Integer, primary_key=True, autoincrement=False),  # since 1970-01-01, UTC
    sa.Column("map_id", sa.BigInteger, nullable=False),  # of the view, for the index below
    sa.Column("basis", sa.Text, nullable=False),  # digest of what the scores depend on
    sa.Column("matches", sa.Integer, nullable=False),
    sa.Column("total", sa.Double, nullable=False),  # sum of the scores
    _seal(),
    _unsealed("day_scores", "seq"),
    sa.Index("day_scores_by_map", "map_id", "day"),
)

VOCABULARIES = sa.Table(
    "vocabularies",
    METADATA,
    sa.Column("digest", sa.Text, primary_key=True),
    sa.Column("tensors", Body, nullable=False),  # safetensors; the digest is their SHA-256
)

WORKERS = sa.Table(  # see workers.py
    "workers",
    METADATA,
    sa.Column("name", sa.Text, primary_key=True),  # of one process, never used twice
    sa.Column("kind", sa.Text, nullable=False),  # serve or worker
    sa.Column("host", sa.Text, nullable=False),
    sa.Column("pid", sa.Integer, nullable=False),
    sa.Column("started_at", UtcDateTime, nullable=False),
    sa.Column("seen_at", UtcDateTime, nullable=False),  # for people: hosts may differ in their clocks
    sa.Column("beats", sa.BigInteger, nullable=False),  # counts the signs of life
    sa.Column("encoder", sa.Text),  # that it describes by; null: of a version that did not say
)

CALLS = sa.Table(
    "calls",
    METADATA,
    sa.Column("key", sa.Text, primary_key=True),
    sa.Column("fingerprint", sa.Text, nullable=False),
    sa.Column("begun_at", UtcDateTime, nullable=False),
    sa.Column("finished_at", UtcDateTime),
    sa.Column("status", sa.Integer),
    sa.Column("headers", sa.Text),  # JSON
    sa.Column("body", Body),
    _seal(),
    _unsealed("calls", "key"),
    sa.Index("calls_by_age", "begun_at"),
)

KEYS = sa.Table(
    "keys",
    METADATA,
    sa.Column("id", sa.Text, primary_key=True),
    sa.Column("name", sa.Text, nullable=False),
    sa.Column("digest", Body, nullable=False),  # SHA-256
    sa.Column("scope", sa.Text, nullable=False),
    sa.Column("maps", sa.Text),  # JSON; NULL: all
    sa.Column("requests_per_minute", sa.Integer),  # NULL: as the settings say, like the next two
    sa.Column("images_per_minute", sa.Integer),
    sa.Column("mb_per_minute", sa.Double),
    sa.Column("created_at", UtcDateTime, nullable=False),
    sa.Column("expires_at", UtcDateTime),
    sa.Column("revoked_at", UtcDateTime),  # kept, so that revoking the last key does not open the service
    sa.Column("last_used_at", UtcDateTime),
    _seal(),
    _unsealed("keys", "id"),
)
