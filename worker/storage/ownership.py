"""Whose images lie at a place. To any other database they all look like what a crash left, and it would remove them.

So the place has a file with the id of the database that the images were enrolled into. With another database, one named
by mistake in REVISIT_DATABASE or REVISIT_IMAGES or begun anew because its file was lost, a service does not start, and
nothing is removed.
"""

import uuid

import sqlalchemy as sa

from schemas.errors import Damaged, RevisitError, SetupError
from worker.storage.database import Database
from worker.storage.image_store import ImageStore
from worker.storage.rows import log
from worker.storage.tables import CLOCK, INSTALLATION, VIEWS


def refuse_foreign(database: Database, images: ImageStore) -> None:
    """Raise SetupError where the images at a place are of another database; pass where that cannot be read."""
    try:
        owner = images.owner()
        with database.reading() as connection:
            own = id_of(connection)
    except RevisitError:  # queries can be answered all the same
        return
    if owner is not None and own is not None and owner != own:
        raise SetupError(
            f"the images are of another database: its id stands in {images.owner_name}; see REVISIT_DATABASE, "
            "REVISIT_IMAGES and REVISIT_DATA. If that database is gone for good, remove this file: the next start "
            "removes all images that no view of this one needs"
        )


def is_own(database: Database, images: ImageStore) -> bool:
    """Whether the images at a place are this database's; logs if not. A place without an owner becomes this database's.

    Raises
    ------
    DiskFull, StorageFailed
    """
    try:
        own, owner = _own_id(database), images.owner()
    except Damaged as error:
        log.error("whose images these are cannot be read, and none is removed: %s", error.detail)
        return False
    if owner is None and _is_begun_anew(database) and images.holds_any():  # told by no version before
        log.error(
            "the database is new, and there are images already, which are kept: stop the service if REVISIT_DATABASE "
            "is not the one that they belong to, or if its file was lost"
        )
        return False
    if owner is None:
        images.claim(own)
    elif owner != own:
        log.error("the images are of another database by %s, and none is removed", images.owner_name)
    return owner in (None, own)


def id_of(connection: sa.Connection) -> str | None:
    """The id of a database; None where a damaged file lost it."""
    return connection.scalar(sa.select(INSTALLATION.c.id).limit(1))


def _own_id(database: Database) -> str:
    with database.reading() as connection:
        found = id_of(connection)
    if found is None:
        found = str(uuid.uuid4())
        with database.writing() as connection:
            connection.execute(sa.insert(INSTALLATION).values(id=found))
    return found


def _is_begun_anew(database: Database) -> bool:
    with database.reading() as connection:
        return is_new(connection)


def is_new(connection: sa.Connection) -> bool:
    """Whether nothing was ever enrolled into a database: images that nobody has taken are not its."""
    last = connection.scalar(sa.select(CLOCK.c.revision))
    return last in (None, 0) and not connection.scalar(sa.select(sa.exists(sa.select(VIEWS.c.id))))
