"""Images that were deleted while an import into their map waited or ran, so that it does not bring them back.

An import that goes on after a crash begins with the first image of its recording, and knows what is done by what the
map has. Notes are by the digests of what was sent and of what was stored, and end with the job.
"""

from collections.abc import Collection

import sqlalchemy as sa

from schemas.errors import ViewDeleted
from worker.storage.switching import UNFINISHED
from worker.storage.tables import DELETED_IMAGES, JOBS

SINCE = "its view was deleted while this import waited or ran, so that it is not enrolled again"


def note(connection: sa.Connection, map_id: int, digests: Collection[str]) -> None:
    """Note deleted images, by their SHA-256, with each import into a map that has not ended."""
    unfinished = JOBS.c.map_id == map_id, JOBS.c.kind == "import", JOBS.c.state.in_(UNFINISHED)
    # Locked, because one may be ending at this moment: its notes would stay.
    imports = connection.scalars(sa.select(JOBS.c.number).where(*unfinished).order_by(JOBS.c.number).with_for_update())
    for job in list(imports):
        mine = DELETED_IMAGES.c.job == job, DELETED_IMAGES.c.sha256.in_(digests)
        known = set(connection.scalars(sa.select(DELETED_IMAGES.c.sha256).where(*mine)))
        rows = [{"job": job, "sha256": digest} for digest in sorted(set(digests) - known)]
        if rows:
            connection.execute(sa.insert(DELETED_IMAGES), rows)


def refuse(connection: sa.Connection, job: int, digests: Collection[str]) -> None:
    """Raise ViewDeleted where an image was deleted while an import, by its number, waited or ran."""
    noted = DELETED_IMAGES.c.job == job, DELETED_IMAGES.c.sha256.in_(digests)
    if connection.execute(sa.select(DELETED_IMAGES.c.job).where(*noted).limit(1)).first() is not None:
        raise ViewDeleted(SINCE)


def forget(connection: sa.Connection, job: int) -> None:
    """Remove the notes of an import that ends, by its number."""
    connection.execute(sa.delete(DELETED_IMAGES).where(DELETED_IMAGES.c.job == job))
