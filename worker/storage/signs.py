"""Signs of life beside the images, by which a start finds out that another copy of its database works on them.

A copy has the id of the first database (see ownership.py): the images of both look like its own, and what was enrolled
into the other one since looks like what a crash left. So each process counts in its database, now and then, and writes
the count beside the images. A count there that is ahead of the database's comes from a copy that is served and goes on
counting, or from this database before it was restored from a backup.

In an object store alone: a folder of images lies in a data folder, which has one service.
"""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import sqlalchemy as sa

from schemas.errors import RevisitError, SetupError
from worker.storage import owner_file
from worker.storage.database import Database
from worker.storage.rows import log
from worker.storage.tables import INSTALLATION

if TYPE_CHECKING:
    from worker.storage.object_files import ObjectFiles  # loads boto3, which a folder does not need

ALIVE = "alive"
"""Name of the object."""

EVERY_S = 60.0
"""Seconds between two signs of a process."""

SILENT_S = 1.5 * EVERY_S
"""Age from which a sign counts as the last one of its process."""

SLACK = 2
"""Counts that a database may lack whose server took over from another one that did not wait for it."""

LOOK_EVERY_S = 2.0

COPIED = (
    "a copy of this database is served with the images in {0}, or this one is the copy: {0}/{1} goes on counting ahead "
    "of this database, which would remove images of the other one. Give it a REVISIT_IMAGES of its own, with a copy of "
    "the images, or stop the other services"
)


class Sign(NamedTuple):
    """What stands beside the images: the id of a database, its count, and the sign's age by the store's clock."""

    owner: str
    beats: int
    age_s: float


class SignsOfLife:
    """Gives the signs of life of this process.

    Parameters
    ----------
    database : Database
    files : ObjectFiles or None
        Where images lie; None: in a folder, where no signs are needed.
    """

    def __init__(self, database: Database, files: "ObjectFiles | None") -> None:
        self._database, self._files = database, files
        self._given = float("-inf")

    def give(self) -> None:
        """Give one if it is time to; does nothing while the database or the store is away."""
        if self._files is None or time.monotonic() - self._given < EVERY_S:
            return
        self._given = time.monotonic()
        try:
            with self._database.writing(in_turn=False, frees=True) as connection:
                connection.execute(sa.update(INSTALLATION).values(beats=INSTALLATION.c.beats + 1))
                counted = connection.execute(sa.select(INSTALLATION).limit(1)).one_or_none()
            if counted is not None:
                self._files.write(ALIVE, owner_file.written(f"{counted.id}:{counted.beats}"))
        except RevisitError as error:
            log.debug("no sign of life was given: %s", error.detail)


def read(files: "ObjectFiles") -> Sign | None:
    """The last sign that was given; None where there is none, or a damaged one; raises StorageFailed."""
    try:
        age_s = files.age_s(ALIVE)
        owner, _, count = (owner_file.read(files.read(ALIVE)) or "").rpartition(":")
    except FileNotFoundError:
        return None
    return Sign(owner, int(count), age_s) if owner and count.isdigit() else None


def is_elsewhere(sign: Sign | None, connection: sa.Connection) -> bool:
    """Whether a sign, read before, was given for another copy of this database not long ago."""
    if sign is None or sign.age_s >= SILENT_S:
        return False
    own = connection.execute(sa.select(INSTALLATION).limit(1)).one_or_none()
    return own is not None and own.id == sign.owner and sign.beats > own.beats + SLACK


def refuse_copy(database: Database, files: "ObjectFiles | None", rest: Callable[[float], object] = time.sleep) -> None:
    """Raise SetupError where another copy of a database works on its images; return where that cannot be read.

    A database that was restored from a backup waits until the last sign from before is `SILENT_S` old.
    """
    first: Sign | None = None
    while files is not None:
        try:
            sign = read(files)
            with database.reading() as connection:
                ahead = is_elsewhere(sign, connection)
        except RevisitError:  # queries can be answered all the same
            return
        if sign is None or not ahead:
            return
        if first is None:
            first = sign
            log.warning(
                "another copy of the database was served with the images in %s %d s ago; whether it still is, is seen "
                "within %d s", files.address, sign.age_s, SILENT_S,
            )  # fmt: skip
        elif sign.beats != first.beats:
            raise SetupError(COPIED.format(files.address, ALIVE))
        rest(LOOK_EVERY_S)
