"""The tables that PostgreSQL searches vectors in, by the extension pgvector: made only where a setting asks for it.

::

    searched_maps       what of a map by a recipe the table below has: everything up to a revision
    searched_vectors    a histogram vector of one view and channel; goes with the view's description

They are a cache of `vectors` inside the database, and not part of `tables.METADATA`: no other code needs them.
"""

import re
from typing import Any

import sqlalchemy as sa

from schemas.errors import SetupError, StorageFailed
from worker.storage.columns import UtcDateTime
from worker.storage.database import Database
from worker.storage.disk_errors import lacking_right
from worker.storage.tables import VECTORS

EXTENSION = "vector"
OLDEST = (0, 8, 0)
"""The first pgvector whose HNSW search goes on until filters leave enough."""

_OLD = (
    "pgvector 0.8.0 or newer is needed, and the database has {}; install a newer one on its server and run `ALTER "
    "EXTENSION vector UPDATE`"
)

SQLITE = (
    "the database is a file of SQLite; set REVISIT_DATABASE to postgresql://user@host/name, or leave REVISIT_INDEX out "
    "to search in memory"
)

TURN = 0x7265766973697401
"""Key of the advisory lock under which the tables are made."""

SEARCHED = sa.MetaData()


class Vector(sa.types.UserDefinedType[str]):
    """A vector of pgvector, as its text; without `size` of any length."""

    cache_ok = True

    def __init__(self, size: int | None = None) -> None:
        self.size = size

    def get_col_spec(self, **_: Any) -> str:
        """The type in SQL."""
        return EXTENSION if self.size is None else f"{EXTENSION}({self.size})"


SEARCHED_MAPS = sa.Table(
    "searched_maps",
    SEARCHED,
    sa.Column("id", sa.BigInteger, sa.Identity(), primary_key=True),
    sa.Column("map_id", sa.BigInteger, nullable=False),
    sa.Column("recipe", sa.Text, nullable=False),
    sa.Column("revision", sa.BigInteger),  # NULL until it was filled once
    sa.Column("recall", sa.Double),  # of HNSW against an exact search, 0 to 1; NULL until it was measured
    sa.Column("measured_views", sa.BigInteger),  # that the map had then
    sa.Column("measured_at", UtcDateTime),
    sa.UniqueConstraint("map_id", "recipe", name="searched_maps_once"),
)

SEARCHED_VECTORS = sa.Table(
    "searched_vectors",
    SEARCHED,
    sa.Column("searched_id", sa.BigInteger, primary_key=True),
    sa.Column("channel", sa.SmallInteger, primary_key=True),  # position among the recipe's channels
    sa.Column("seq", sa.BigInteger, primary_key=True),
    sa.Column("recipe", sa.Text, nullable=False),
    sa.Column("vector", Vector(), nullable=False),
    sa.Index("searched_vectors_by_view", "seq", "recipe"),
)

_REFERENCES = (
    "ALTER TABLE searched_vectors ADD CONSTRAINT searched_vectors_in FOREIGN KEY (searched_id) "
    "REFERENCES searched_maps ON DELETE CASCADE",
    "ALTER TABLE searched_maps ADD CONSTRAINT searched_maps_of FOREIGN KEY (map_id) REFERENCES maps ON DELETE CASCADE",
    f"ALTER TABLE searched_vectors ADD CONSTRAINT searched_vectors_of FOREIGN KEY (seq, recipe) "
    f"REFERENCES {VECTORS.name} (seq, recipe) ON DELETE CASCADE",
)


def prepare(database: Database) -> str:
    """Make the extension and the tables where they are missing; returns the version of pgvector.

    Raises
    ------
    SetupError
        The database is no PostgreSQL, or pgvector is missing, too old or not allowed; the text says what to do.
    """
    if database.engine.dialect.name != "postgresql":
        raise SetupError(f"REVISIT_INDEX=pgvector: {SQLITE}")
    with database.reading() as connection:
        found = _installed(connection)
        made = found is not None and sa.inspect(connection).has_table(SEARCHED_VECTORS.name)
    if not made:
        found = _make(database)
    if found is None or _is_old(found):
        raise SetupError(f"REVISIT_INDEX=pgvector: {_OLD.format(found)}")
    return found


def fault(connection: sa.Connection) -> str | None:
    """What a database lacks to search vectors, with what to do; None when it has everything."""
    if connection.dialect.name != "postgresql":
        return SQLITE
    found = _installed(connection)
    if found is None:
        return _lacking(connection)
    if _is_old(found):
        return _OLD.format(found)
    if not sa.inspect(connection).has_table(SEARCHED_VECTORS.name):
        return "the tables that vectors are searched in are missing; `./revisit migrate` makes them"
    return None


def _is_old(found: str) -> bool:
    return tuple(int(part) for part in re.findall(r"\d+", found)[:3]) < OLDEST


def _installed(connection: sa.Connection) -> str | None:
    found: str | None = connection.scalar(sa.text(f"SELECT extversion FROM pg_extension WHERE extname = '{EXTENSION}'"))
    return found


def _lacking(connection: sa.Connection) -> str:
    server = connection.scalar(sa.text("SHOW server_version"))
    offered = connection.scalar(sa.text(f"SELECT 1 FROM pg_available_extensions WHERE name = '{EXTENSION}'"))
    if offered is None:
        return (
            f"the server of the database (PostgreSQL {server}) does not offer the extension pgvector; install it there "
            "(Debian: postgresql-NN-pgvector), or leave REVISIT_INDEX out to search in memory"
        )
    return "the database lacks the extension pgvector, which its server offers; `CREATE EXTENSION vector` makes it"


def _make(database: Database) -> str | None:
    with database.reading() as connection:
        lacking = None if _installed(connection) is not None else _lacking(connection)
    if lacking is not None and "does not offer" in lacking:
        raise SetupError(f"REVISIT_INDEX=pgvector: {lacking}")
    try:
        with database.writing(in_turn=False) as connection:
            connection.execute(sa.text(f"SELECT pg_advisory_xact_lock({TURN})"))  # several nodes may start at once
            if _installed(connection) is None:
                connection.execute(sa.text(f"CREATE EXTENSION {EXTENSION}"))
            missing = not sa.inspect(connection).has_table(SEARCHED_VECTORS.name)
            see_extension(connection)  # whose schema may be that of another service, with tables of the same names
            if missing:
                SEARCHED.create_all(connection, checkfirst=False)
                for statement in _REFERENCES:
                    connection.execute(sa.text(statement))
            return _installed(connection)
    except StorageFailed as error:
        said = lacking_right(error)
        if said is None:
            raise
        raise SetupError(
            f"REVISIT_INDEX=pgvector: {lacking or 'its tables are missing'}, and the user of REVISIT_DATABASE may not "
            f"({said}); have an owner of the database do it once"
        ) from error


def see_extension(connection: sa.Connection) -> None:
    """Let the transaction find the extension's types and operators, whatever schema they are in."""
    connection.execute(_SEE)


_SEE = sa.text(
    "SELECT set_config('search_path', current_setting('search_path') || ', ' || quote_ident(nspname), true) "
    f"FROM pg_extension JOIN pg_namespace ON pg_namespace.oid = extnamespace WHERE extname = '{EXTENSION}'"
)
