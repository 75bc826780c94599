"""Transactions: context managers for reading and writing."""

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import sqlalchemy as sa

from schemas.errors import Damaged, DiskFull, StorageFailed
from worker.storage import dialect, error_codes, sealing
from worker.storage.disk_errors import DAMAGED, FULL, problem_of, translated
from worker.storage.retrying import Commits, run_with_retries
from worker.storage.space import Space

T = TypeVar("T")

log = logging.getLogger("revisit")

TRUNCATE_PATIENCE_S = 0.5

PROMPT_S = 1.0
"""Seconds within which a server that is starting, or that has failed over, refuses a connection: it is tried again."""


class Database:
    """Connections to one database.

    Parameters
    ----------
    url : str
        SQLAlchemy URL.

    Raises
    ------
    SetupError
        The URL is not of a database that revisit can use.
    """

    def __init__(self, url: str) -> None:
        self.engine = dialect.make_engine(url)
        sealing.follow(self.engine)
        self.space: Space | None = None
        self.commits = Commits()
        self.trouble: str | None = None  # why the last transaction that wrote could not be stored
        self._stains, self._scrubbed = 1, 0  # the first is of what a crash left

    def open(self) -> sa.Connection:
        """A connection.

        Raises
        ------
        StorageFailed
            The server neither gave nor refused one within `PROMPT_S`: it will be silent for longer.
        """
        began = time.monotonic()
        try:
            return self.engine.connect()
        except sa.exc.DBAPIError as error:
            prompt = dialect.is_file(self.engine) or time.monotonic() - began < PROMPT_S
            problem = None if prompt else problem_of(error, "database")
            if problem is None:
                raise
            raise problem from error

    @contextmanager
    def reading(self) -> Iterator[sa.Connection]:
        """A transaction whose reads all see the same snapshot; raises StorageFailed or Damaged when its file fails."""
        try:
            with translated("database", sent=False), self.open() as connection:
                connection = dialect.for_reading(connection)
                with connection.begin():
                    yield connection
        except UnicodeDecodeError as error:  # a message of SQLite's that quotes a damaged definition
            raise Damaged(DAMAGED.format("its definitions cannot be read")) from error

    @contextmanager
    def writing(
        self, *, in_turn: bool = True, durable: bool = True, frees: bool = False, patience_s: float | None = None
    ) -> Iterator[sa.Connection]:
        """A transaction that is committed durably at the end of the block, or rolled back when the block raises.

        Parameters
        ----------
        in_turn : bool
            Whether to exclude other writers; False only for writes without a new revision.
        durable : bool
            Whether a power failure must not undo it once it is committed; False only for what a start does without, as
            who works on what: flash wears out by what is synced.
        frees : bool
            Whether it deletes, or replaces little: it may then use the last space of the disk.
        patience_s : float or None
            For which it waits for others that write; None: a minute.

        Raises
        ------
        DiskFull, StorageFailed, Damaged
        """
        if self.space is not None and not frees:
            self.space.require()
        sent = False
        try:
            with self.open() as connection:
                connection = dialect.for_writing(connection)
                with (
                    dialect.patient(connection, patience_s),
                    dialect.synced(connection, durable),
                    connection.begin(),
                ):
                    dialect.begin_writing(connection, in_turn=in_turn, patience_s=patience_s)
                    sealing.begin(connection)
                    yield connection
                    sealing.seal(connection)
                    sent = True
                self.commits.count += 1
            self.trouble = None
        except (OSError, sa.exc.DBAPIError) as error:
            problem = problem_of(error, "database", sent=sent)
            if problem is None:
                raise
            # SQLite says of a used-up quota, and of a disk that is full when it is synced, only that there is an error.
            if isinstance(problem, StorageFailed) and self.space is not None and self.space.refused():
                problem = DiskFull(FULL.format("database"))
            if isinstance(error, sa.exc.DBAPIError) and error_codes.is_read_only(error):
                self.engine.dispose()  # another connection may find the server that takes writes, or that this one does
            if patience_s is None or not error_codes.is_busy(error):  # others that write for a moment are no trouble
                self.trouble = problem.detail
            raise problem from error

    def freeing(self, work: Callable[[sa.Connection], T]) -> T:
        """Run what makes room in a transaction, on a full disk with the reserve given up for it; raises DiskFull.

        `work` is retried where it was rolled back, also after other transactions of the same call.
        """

        def run() -> T:
            with self.writing(frees=True) as connection:
                return work(connection)

        try:
            freed = run_with_retries(self.commits, run)
        except DiskFull:
            if self.space is None or not self.space.give_up():
                raise
            self._truncate_journal(TRUNCATE_PATIENCE_S)
            freed = run()
        self.stain()
        return freed

    def stain(self) -> None:
        """Note that a transaction which was committed has deleted or replaced what is to be gone."""
        self._stains += 1

    def scrub(self, patience_s: float = TRUNCATE_PATIENCE_S) -> None:
        """Empty SQLite's journal, where what was deleted or replaced still stands as it was.

        Does nothing without a stain. Where others read for longer than `patience_s`, the stains stay for the next time.
        """
        stains = self._stains
        if stains != self._scrubbed and self._truncate_journal(patience_s):
            self._scrubbed = stains

    def tidy(self) -> None:
        """After deletions on a disk that is nearly full: give the journal's space back and make the reserve again."""
        if self.space is not None and self.space.low():
            self._truncate_journal(TRUNCATE_PATIENCE_S)
            self.space.restore()

    def _truncate_journal(self, patience_s: float) -> bool:
        """Copy SQLite's journal into the database and give its space back, unless readers are in the way.

        Returns whether nothing is left in it.
        """
        if not dialect.is_file(self.engine):
            return True
        try:
            with (
                self.engine.connect() as connection,
                dialect.patient(connection, patience_s),
                dialect.raw_cursor(connection) as raw,
            ):
                [(blocked, *_)] = raw.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        except sa.exc.DBAPIError as error:
            log.debug("the journal keeps its size: %s", error)
            return False
        return not blocked

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()
