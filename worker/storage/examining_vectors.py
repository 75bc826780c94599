"""Examines what PostgreSQL searches vectors in, read only."""

import sqlalchemy as sa

from worker.storage import dialect, vector_tables
from worker.storage.finding import Finding
from worker.storage.rows import find_recipe
from worker.storage.tables import DESCRIPTIONS, MAPS
from worker.storage.vector_tables import SEARCHED_MAPS, SEARCHED_VECTORS

LEAST_RECALL = 0.95
"""Of HNSW; less is a finding."""

NEEDED = "the service does not start before"

TABLE = f"table {SEARCHED_VECTORS.name}"


def vector_findings(url: str, *, approximate: bool) -> tuple[str, list[Finding]]:
    """The state of the index in one line, and what is wrong with it.

    Parameters
    ----------
    url : str
        SQLAlchemy URL of the database.
    approximate : bool
        Whether HNSW is searched.
    """
    if sa.make_url(url).get_backend_name() == "sqlite":
        return "missing", [Finding("REVISIT_INDEX", vector_tables.SQLITE, NEEDED)]
    try:
        with (
            dialect.reader(url) as engine,
            engine.connect() as plain,
            dialect.for_reading(plain) as connection,
            connection.begin(),
        ):
            if (fault := vector_tables.fault(connection)) is not None:
                return "missing", [Finding("REVISIT_INDEX", fault, NEEDED)]
            found = [one for row in connection.execute(_SEARCHED) if (one := _short(connection, row)) is not None]
            recalls = [(row.name, row.recall) for row in connection.execute(_SEARCHED) if row.recall is not None]
    except sa.exc.SQLAlchemyError as error:
        return "not examined", [Finding(TABLE, f"cannot be read ({getattr(error, 'orig', error)})", "see the server")]
    if approximate:
        found += [
            Finding(f"map {name}", f"HNSW finds {recall:.1%} of the nearest views", "REVISIT_INDEX=pgvector is exact")
            for name, recall in recalls
            if recall < LEAST_RECALL
        ]
    measured = "".join(f"; {name}: recall {recall:.4f}" for name, recall in recalls) if approximate else ""
    return f"{'HNSW' if approximate else 'exact'} in PostgreSQL{measured}", found


def _short(connection: sa.Connection, row: sa.Row[tuple[int, str, str, int, int]]) -> Finding | None:
    """What a map lacks of the vectors that it should have at its revision."""
    described = sa.select(sa.func.count()).where(
        DESCRIPTIONS.c.map_id == row.map_id,
        DESCRIPTIONS.c.recipe == row.recipe,
        DESCRIPTIONS.c.revision <= row.revision,
    )
    there = sa.select(sa.func.count()).where(SEARCHED_VECTORS.c.searched_id == row.id)
    channels = len(find_recipe(connection, row.recipe).parameters.channels)
    want, have = channels * int(connection.scalar(described) or 0), int(connection.scalar(there) or 0)
    if want == have:
        return None
    return Finding(
        f"map {row.name}",
        f"PostgreSQL searches {have} vectors of {want}",
        f"`DELETE FROM {SEARCHED_MAPS.name} WHERE id = {row.id}` has the next query fill it again",
    )


_SEARCHED = (
    sa.select(SEARCHED_MAPS, MAPS.c.name)
    .join(MAPS, (MAPS.c.id == SEARCHED_MAPS.c.map_id) & (MAPS.c.recipe == SEARCHED_MAPS.c.recipe))
    .where(MAPS.c.name.is_not(None), SEARCHED_MAPS.c.revision.is_not(None), MAPS.c.anew <= SEARCHED_MAPS.c.revision)
    .order_by(MAPS.c.name)
)
