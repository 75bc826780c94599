"""The store: one database, SQLite or PostgreSQL, and a folder of images."""

import os
from datetime import datetime
from pathlib import Path

import sqlalchemy as sa

from schemas.errors import SetupError
from worker.storage.calls import Calls, Vocabularies
from worker.storage.database import Database
from worker.storage.descriptions import Descriptions
from worker.storage.enrolment import Enrolment
from worker.storage.image_files import Images
from worker.storage.listings import Listings
from worker.storage.locks import FolderLock
from worker.storage.map_jobs import MapJobs
from worker.storage.maps import Maps
from worker.storage.migrating import enter, migrates_by_itself
from worker.storage.pruning import Pruning
from worker.storage.removals import Removals
from worker.storage.rows import batches
from worker.storage.tables import CALLS, CLOCK, VIEWS
from worker.storage.views import Views


class SqlStore:
    """Maps, views, descriptions, jobs, vocabularies and calls: the truth. What a method has returned from is durable.

    Composed of parts, each a module beside this one; who uses a part names what it needs in a Protocol of its own.

    Parameters
    ----------
    database : Database
        With the tables that this version needs.
    data : Path
        Folder whose ``pictures`` hold the originals.
    share : FolderLock
        Keeps others from migrating the database; let go of by `close`.
    """

    def __init__(self, database: Database, data: Path, share: FolderLock) -> None:
        self._database = database
        self._data = data
        self._share = share
        self._images = images = Images(data / "pictures", self._owned)
        self.maps = Maps(database, images)
        self.enrolment = Enrolment(database, images)
        self.jobs = MapJobs(database, images)
        self.views = Views(database, images)
        self.removals = Removals(database, images)
        self.listings = Listings(database, images)
        self.descriptions = Descriptions(database, images)
        self.vocabularies = Vocabularies(database, images)
        self.calls = Calls(database, images)
        self.pruning = Pruning(database, images)

    def _owned(self, digests: list[str]) -> set[str]:
        """Those of these images that views need."""
        found: set[str] = set()
        with self._database.reading() as connection:
            for portion in batches(digests):
                found.update(connection.scalars(sa.select(VIEWS.c.sha256).where(VIEWS.c.sha256.in_(portion))))
        return found

    def recover(self, now: datetime) -> None:
        """After a crash: forget half-made calls and image files that no view owns, finish deletions.

        For the one `serve` of a data folder, before it takes its first call: a call that runs elsewhere would be
        forgotten too.
        """
        with self._database.writing(in_turn=False) as connection:
            connection.execute(sa.delete(CALLS).where(CALLS.c.finished_at.is_(None), CALLS.c.begun_at <= now))
        self.removals.clear_deleted_maps()
        self._images.sweep()

    def check(self) -> str:
        """``ok``, or what is wrong with the database or the folder."""
        try:
            with self._database.reading() as connection:
                if connection.scalar(sa.select(CLOCK.c.revision)) is None:
                    return "the database has lost its clock; restore a snapshot"
        except sa.exc.SQLAlchemyError as error:
            return f"the database does not answer: {getattr(error, 'orig', None) or error}"
        folder = self._data / "pictures"
        if not os.access(folder, os.R_OK | os.W_OK | os.X_OK):
            return f"the folder {folder} is missing or cannot be written"
        return "ok"

    def close(self) -> None:
        """Let go of files and connections; a second time does nothing."""
        self._database.close()
        self._share.release()


def open_store(url: str, data: Path) -> SqlStore:
    """Open the store of a data folder.

    A SQLite file is brought up to date first, when no other process uses the folder; a PostgreSQL database only when
    it is empty (`./revisit migrate` does it otherwise, when the operator wants it).

    Parameters
    ----------
    url : str
        SQLAlchemy URL of the database.
    data : Path
        Data folder, made when there is none.

    Raises
    ------
    SetupError
        The database cannot be used as it is; the text says what to do.
    """
    database = Database(url)
    try:
        # First, so that no lock is held when it fails.
        (data / "pictures").mkdir(parents=True, exist_ok=True)
        share = enter(database, data, may_migrate=migrates_by_itself(database))
        return SqlStore(database, data, share)
    except OSError as error:
        database.close()
        raise SetupError(f"the data folder {data} cannot be used: {error.strerror}; see REVISIT_DATA") from error
    except sa.exc.DBAPIError as error:
        database.close()
        raise SetupError(f"the database cannot be used: {error.orig}; see REVISIT_DATABASE") from error
    except BaseException:
        database.close()
        raise
