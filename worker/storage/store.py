"""The store: one database, SQLite or PostgreSQL, and a folder of images."""

import os
from datetime import datetime
from pathlib import Path

import sqlalchemy as sa

from schemas.errors import Damaged, SetupError
from worker.storage.calls import Calls, Vocabularies
from worker.storage.comparisons import Comparisons
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
    """Maps, views, descriptions, jobs, vocabularies and calls. When a method returns, its changes are durable.

    Composed of parts, each in a module of this package; users of a part declare the methods they call in a Protocol.

    Parameters
    ----------
    database : Database
        Migrated to the tables of this version.
    data : Path
        Data folder; its folder ``pictures`` holds the enrolled images.
    share : FolderLock
        Shared lock that keeps migrations out; released by `close`.
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
        self.comparisons = Comparisons(database, images)
        self.vocabularies = Vocabularies(database, images)
        self.calls = Calls(database, images)
        self.pruning = Pruning(database, images)

    def _owned(self, digests: list[str]) -> set[str]:
        """The digests among `digests` that views need."""
        found: set[str] = set()
        with self._database.reading() as connection:
            for portion in batches(digests):
                found.update(connection.scalars(sa.select(VIEWS.c.sha256).where(VIEWS.c.sha256.in_(portion))))
        return found

    def recover(self, now: datetime) -> None:
        """Clean up after a crash: delete unfinished calls and image files without a view, finish deletions.

        Only for the `serve` process of a data folder, before its first call: it would delete running calls too.
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
        except Damaged as error:
            return error.detail
        except sa.exc.SQLAlchemyError as error:
            return f"the database does not answer: {getattr(error, 'orig', None) or error}"
        folder = self._data / "pictures"
        if not os.access(folder, os.R_OK | os.W_OK | os.X_OK):
            return f"the folder {folder} is missing or cannot be written"
        return "ok"

    def close(self) -> None:
        """Close connections and release the data folder; a second time does nothing."""
        self._database.close()
        self._share.release()


def open_store(url: str, data: Path) -> SqlStore:
    """Open the store of a data folder.

    A SQLite file is migrated first, if no other process uses the folder; a PostgreSQL database only when it is empty
    (otherwise the operator runs `./revisit migrate`).

    Parameters
    ----------
    url : str
        SQLAlchemy URL of the database.
    data : Path
        Data folder, created when there is none.

    Raises
    ------
    SetupError
        The database cannot be used as it is; the text says what to do.
    """
    database = Database(url)
    try:
        # First, so that no lock is held if it fails.
        (data / "pictures").mkdir(parents=True, exist_ok=True)
        share = enter(database, data, may_migrate=migrates_by_itself(database))
        return SqlStore(database, data, share)
    except OSError as error:
        database.close()
        raise SetupError(f"the data folder {data} cannot be used: {error.strerror}; see REVISIT_DATA") from error
    except Damaged as error:
        database.close()
        reason = getattr(error.__cause__, "orig", error.__cause__)
        raise SetupError(
            f"the database cannot be used: {reason}; see REVISIT_DATABASE; if it was whole once, `./revisit doctor "
            "--repair` saves what can be read, and a backup has the rest"
        ) from error
    except sa.exc.DBAPIError as error:
        database.close()
        raise SetupError(f"the database cannot be used: {error.orig}; see REVISIT_DATABASE") from error
    except BaseException:
        database.close()
        raise
