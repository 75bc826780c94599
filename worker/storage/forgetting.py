"""Maps that keep no images: an image is removed once its view is described.

A view that is not described, or is to be by another recipe too, or whose description was damaged, keeps its image, for
it is needed. Which images are removed is decided by `image_store.needs_image` alone, so that what a crash leaves is
swept at the next start.
"""

from typing import Any

import sqlalchemy as sa

from schemas.errors import Conflict
from worker.storage import switching
from worker.storage.database import Database
from worker.storage.image_store import ImageStore, forgets
from worker.storage.rows import has_views
from worker.storage.switching import UNFINISHED
from worker.storage.tables import JOBS, MAPS, VIEWS

PORTION = 1000
"""Images removed at a time."""

READING = ("recipe", "shadow", "vocabulary", "snapshot")
"""Kinds of jobs that read the images of a map."""


def set_keep_images(connection: sa.Connection, row: sa.Row[Any], wanted: bool) -> bool:
    """Keep a map's images, or each from now on until its view is described.

    Returns
    -------
    bool
        Whether `remove_all` is to be called after the commit.

    Raises
    ------
    Conflict
        A job that reads the images has not finished, or the map has a shadow; or images are to be kept again, but
        those of views are gone.
    """
    if wanted != bool(row.drop_images):
        return not wanted  # again: removing the images may have broken off the first time
    if wanted and has_views(connection, row.id):
        raise Conflict(
            f"the map {row.name!r} has views whose images are gone; a new map keeps the images enrolled in it"
        )
    if not wanted:
        _refuse_while_read(connection, row)
        switching.refuse_with_shadow(row)
    connection.execute(sa.update(MAPS).where(MAPS.c.id == row.id).values(drop_images=None if wanted else True))
    return not wanted


def remove_all(database: Database, images: ImageStore, map_id: int) -> None:
    """Remove the images of a map's described views; the next start goes on where a crash stopped it."""
    last = -1
    described = sa.select(VIEWS.c.seq, VIEWS.c.sha256).where(VIEWS.c.map_id == map_id, VIEWS.c.state == "ready")
    while True:
        with database.reading() as connection:
            page = described.where(VIEWS.c.seq > last).order_by(VIEWS.c.seq).limit(PORTION)
            rows = connection.execute(page).all()
        if not rows:
            return
        images.discard([row.sha256 for row in rows])
        last = rows[-1].seq


def remove_after_switch(database: Database, images: ImageStore, map_id: int) -> None:
    """Remove the images that a recipe switch needed and that were no longer to be kept; of other maps none."""
    with database.reading() as connection:
        keeps_none = forgets(connection, map_id)
    if keeps_none:
        remove_all(database, images, map_id)


def _refuse_while_read(connection: sa.Connection, row: sa.Row[Any]) -> None:
    reads = JOBS.c.map_id == row.id, JOBS.c.kind.in_(READING), JOBS.c.state.in_(UNFINISHED)
    job = connection.execute(sa.select(JOBS.c.id, JOBS.c.kind).where(*reads).limit(1)).one_or_none()
    if job is not None:
        raise Conflict(
            f"the images of the map {row.name!r} are being read by the {job.kind} job {job.id}; wait until it has "
            f"finished, or DELETE /jobs/{job.id}"
        )
