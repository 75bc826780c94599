"""The store: one database, SQLite or PostgreSQL, and images in a folder or an S3-compatible store."""

import logging
from contextlib import suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import sqlalchemy as sa

from schemas.errors import Damaged, DiskFull, RevisitError, SetupError, StorageFailed
from schemas.statistics import StoreStatistics
from worker.storage import dialect, statistics, wal
from worker.storage.calls import Calls
from worker.storage.comparisons import Comparisons
from worker.storage.database import Database
from worker.storage.day_scores import DayScores
from worker.storage.descriptions import Descriptions
from worker.storage.disk_errors import lacking_right
from worker.storage.enrolment import Enrolment
from worker.storage.image_store import ImageStore, open_images
from worker.storage.kept_queries import KeptQueries
from worker.storage.keys import Keys
from worker.storage.leftovers import Leftovers
from worker.storage.listings import Listings
from worker.storage.locks import FolderLock
from worker.storage.maps import Maps
from worker.storage.migrating import enter, migrates_by_itself
from worker.storage.notices import Notices
from worker.storage.ownership import is_own, refuse_foreign
from worker.storage.peers import Peers, refuse_pooler
from worker.storage.pruning import Pruning
from worker.storage.removals import Removals
from worker.storage.restoring import Restoring
from worker.storage.scratch import Scratch
from worker.storage.signs import SignsOfLife, refuse_copy
from worker.storage.snapshot_places import SNAPSHOTS, SnapshotFolder, SnapshotObjects
from worker.storage.snapshots import Snapshots
from worker.storage.space import Space
from worker.storage.tables import CALLS, CLOCK, VIEWS
from worker.storage.uploads import IMPORTS, SharedUploads, Uploads
from worker.storage.vector_hnsw import VectorIndexing
from worker.storage.vector_search import VectorSearch
from worker.storage.vector_tables import prepare
from worker.storage.views import Views
from worker.storage.vocabularies import Vocabularies
from worker.storage.workers import Workers

log = logging.getLogger("revisit")

PROBE = "can this be written?"
"""Key of a row that is written and removed at once; with spaces, so that no caller can have it."""


DOCTOR = "run `./revisit doctor --repair` with the service stopped"


class SqlStore:
    """Maps, views, descriptions, jobs, vocabularies and calls. When a method returns, its changes are durable.

    Composed of parts, each in a module of this package; users of a part declare the methods they call in a Protocol.

    Parameters
    ----------
    database : Database
        Migrated to the tables of this version.
    data : Path
        Data folder; its folder ``imports`` holds recordings until they are imported, ``snapshots`` those of maps,
        unless images lie in an object store: then these do too.
    share : FolderLock
        Shared lock that keeps migrations out; released by `close`.
    images : ImageStore
    lost : str or None
        What was wrong with the database's log when the store was opened: rows may be missing.
    index : str
        ``faiss``, ``pgvector`` or ``pgvector-hnsw``: whether the database itself searches vectors.
    """

    def __init__(
        self,
        database: Database,
        data: Path,
        share: FolderLock,
        images: ImageStore,
        lost: str | None,
        index: str,
    ) -> None:
        self._database = database
        self._lost = lost
        self._data = data
        self._share = share
        self._images = images
        self._peers = Peers(database)
        self.notices = None if dialect.is_file(database.engine) else Notices(database.engine)
        self.maps = Maps(database, images)
        self.enrolment = Enrolment(database, images)
        self.jobs = self.workers = Workers(database, images)
        self.views = Views(database, images)
        self.listings = Listings(database, images)
        self.descriptions = Descriptions(database, images)
        self.comparisons = Comparisons(database, images)
        self.kept_queries = KeptQueries(database, images)
        self.day_scores = DayScores(database, images)
        self.vocabularies = Vocabularies(database, images)
        self.calls = Calls(database, images)
        self.keys = Keys(database, images)
        self.pruning = Pruning(database, images)
        scratch = Scratch(data / "scratch")
        scratch.sweep()
        files = images.files
        place = SnapshotFolder(data / SNAPSHOTS) if files is None else SnapshotObjects(files, scratch)
        self.snapshots = Snapshots(database, images, data / SNAPSHOTS, place)
        self.removals = Removals(database, images, self.snapshots.holding, self.calls.answers_naming)
        self.restoring = Restoring(database, images, self.removals)
        here = data / IMPORTS, database.space
        self.uploads = Uploads(*here) if files is None else SharedUploads(*here, files, scratch)
        self.jobs.drop_files = self._drop_files
        self.leftovers = None if files is None else Leftovers(database, files, partial(is_own, database, images))
        self.signs = SignsOfLife(database, images.prompt)
        self.vectors = None if index == "faiss" else VectorSearch(database, images)
        self.indexing = VectorIndexing(database, images) if index == "pgvector-hnsw" else None

    def _drop_files(self, job_id: str) -> None:
        """Remove the recording of an import, and what there is of a snapshot."""
        self.uploads.discard(job_id)
        self.snapshots.drop_draft(job_id)

    def refuse_foreign(self) -> None:
        """Close the store and raise SetupError where its images are of another database, or another copy of this one
        works on them, as far as that is known."""
        try:
            refuse_foreign(self._database, self._images)
            refuse_copy(self._database, self._images.prompt)
        except BaseException:
            self.close()
            raise

    def recover(self) -> bool:
        """Clean up after a crash: delete unfinished calls, maps, snapshots and images, and uploads without a job;
        finish deletions.

        Only for the `serve` process of a data folder, before its first call: it would delete running calls too. While
        other services use the database, what is in it may be theirs, and is left alone.

        Returns
        -------
        bool
            Whether there is no other service; False where that is not known.
        """
        try:
            with self._peers.joined() as alone:
                self._clean_up(alone)
                return alone
        except (DiskFull, StorageFailed) as error:  # queries can be answered all the same
            log.error("what a crash left could not be cleaned up: %s; the next start tries again", error.detail)
            return False

    def _clean_up(self, alone: bool) -> None:
        left = CALLS.c.finished_at.is_(None)
        if alone:
            self._database.freeing(lambda connection: connection.execute(sa.delete(CALLS).where(left)))
            self.removals.clear_deleted_maps()
        self.snapshots.sweep()
        self.uploads.sweep(self.jobs.unfinished_imports())
        if self._lost is not None:  # an image without a view may be all that is left of it
            log.error("the log of the database was damaged: %s; images without a view are kept, %s", self._lost, DOCTOR)
        elif is_own(self._database, self._images):
            self._images.sweep_at_start()

    def check(self) -> str:
        """``ok``, or what is wrong with the database or the place of the images."""
        try:
            with self._database.reading() as connection:
                if connection.scalar(sa.select(CLOCK.c.revision)) is None:
                    return "the database has lost its clock; restore a snapshot"
                # All that is enrolled and answered goes by it; another process may have locked it alone.
                connection.execute(sa.select(VIEWS.c.seq).order_by(VIEWS.c.seq.desc()).limit(1)).all()
        except RevisitError as error:
            return error.detail
        except sa.exc.SQLAlchemyError as error:
            return f"the database does not answer: {getattr(error, 'orig', None) or error}"
        return self._images.problem() or "ok"

    def statistics(self, now: datetime, sample: int) -> StoreStatistics:
        """Numbers of views, jobs and bytes; `sample` views of a map are compared at most."""
        return statistics.read(self._database, now, sample)

    def check_space(self) -> str:
        """``ok``, or why nothing can be enrolled now: the disk is full or cannot be written."""
        try:
            problem = None if self._database.space is None else self._database.space.problem()
        except OSError as error:
            problem = f"the folder {self._data} cannot be read: {error.strerror}"
        if problem is None and self._database.trouble is not None:
            self._try_to_write()
        return problem or self._database.trouble or "ok"

    def _try_to_write(self) -> None:
        """Change nothing, durably: whether a disk that failed works again."""
        with (
            suppress(DiskFull, StorageFailed),
            self._database.writing(in_turn=False, frees=True) as connection,
        ):
            # SQLite does not write a row that stays as it is.
            probe = {"key": PROBE, "fingerprint": "", "begun_at": datetime.now(UTC)}
            connection.execute(sa.insert(CALLS), probe)
            connection.execute(sa.delete(CALLS).where(CALLS.c.key == PROBE))

    def tend(self) -> None:
        """What is done now and then: make the reserve for deletions where it is missing, empty the journal of what was
        replaced, count among the services of the database again, finish deletions and calls that could not be finished,
        and give a sign of life."""
        if self._database.space is not None:
            self._database.space.restore()
        self._database.scrub(patience_s=0)
        self._peers.rejoin()
        self.removals.finish_late()
        with suppress(DiskFull, StorageFailed):
            self.calls.finish_late()
            self.calls.expire(datetime.now(UTC), shared=True)
        self.signs.give()

    def close(self) -> None:
        """Close connections and release the data folder; a second time does nothing."""
        self._peers.leave()
        self._images.close()
        self.listings.close()
        self._database.close()
        self._share.release()


def open_store(
    url: str, data: Path, reserve_bytes: int = 0, images: str | None = None, index: str = "faiss"
) -> SqlStore:
    """Open the store of a data folder.

    A SQLite file is migrated first, if no other process uses the folder; a PostgreSQL database only when it is empty
    (otherwise the operator runs `./revisit migrate`).

    Parameters
    ----------
    url : str
        SQLAlchemy URL of the database.
    data : Path
        Data folder, created when there is none.
    reserve_bytes : int
        Space kept for deletions; see space.py.
    images : str or None
        ``s3://bucket/prefix``; None for the folder ``pictures`` in the data folder.
    index : str
        As for `SqlStore`; the tables of another one than ``faiss`` are made when they are missing.

    Raises
    ------
    SetupError
        The database cannot be used as it is; the text says what to do.
    """
    database = Database(url)
    try:
        # First, so that no lock is held if it fails.
        data.mkdir(parents=True, exist_ok=True)
        place = open_images(database, data, images)
        refuse_pooler(database)
        lost = _log_fault(database)  # before SQLite reads the log and takes what it cannot read for never written
        share = enter(database, data, may_migrate=migrates_by_itself(database))
        database.space = Space(_folders(database, data), reserve_bytes)
        if index != "faiss":
            _prepare_or_release(database, share)
        return SqlStore(database, data, share, place, lost, index)
    except BaseException as error:
        database.close()
        if (problem := _setup_problem(error, data)) is None:
            raise
        raise SetupError(problem) from error


def _setup_problem(error: BaseException, data: Path) -> str | None:
    """What an error says to whoever opens a store; None where it says so itself, or is unforeseen."""
    if isinstance(error, SetupError):
        return None
    if isinstance(error, Damaged):
        reason = getattr(error.__cause__, "orig", error.__cause__)
        return (
            f"the database cannot be used: {reason}; see REVISIT_DATABASE; if it was whole once, `./revisit doctor "
            "--repair` saves what can be read, and a backup has the rest"
        )
    if isinstance(error, RevisitError):
        if (said := lacking_right(error)) is not None:
            return (
                f"the user of REVISIT_DATABASE may not use the database as revisit does ({said}); have its owner "
                "grant that, or make the user its owner"
            )
        return f"{error.detail}; see REVISIT_DATA and REVISIT_DATABASE"
    if isinstance(error, OSError):
        return f"the data folder {data} cannot be used: {error.strerror}; see REVISIT_DATA"
    if isinstance(error, sa.exc.DBAPIError):
        return f"the database cannot be used: {error.orig}; see REVISIT_DATABASE"
    return None


def _prepare_or_release(database: Database, share: FolderLock) -> None:
    """Make what pgvector needs; the data folder is released where that cannot be."""
    try:
        prepare(database)
    except BaseException:
        share.release()
        raise


def _folders(database: Database, data: Path) -> list[Path]:
    """The folders of the images and, when it is a file, of the database."""
    file = database.engine.url.database
    return [data, Path(file).resolve().parent] if dialect.is_file(database.engine) and file else [data]


def _log_fault(database: Database) -> str | None:
    """What is wrong with the log of a SQLite file, or None, also for a last frame that is unfinished."""
    file = database.engine.url.database
    if not dialect.is_file(database.engine) or not file:
        return None
    fault = wal.fault(Path(file).with_name(Path(file).name + "-wal"))
    return None if fault == wal.UNFINISHED else fault
