"""Locks among the services of one database: whether others serve it, and who writes or removes which images.

In PostgreSQL these are advisory locks, which end with their connection; with SQLite, whose services share one machine,
locks on files of the data folder.
"""

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path

import sqlalchemy as sa

from schemas.errors import SetupError
from worker.storage import dialect
from worker.storage.database import Database
from worker.storage.disk_errors import AWAY, translated
from worker.storage.locks import held
from worker.storage.retrying import RolledBack

log = logging.getLogger("revisit")

SCHEMA = "hashtext('revisit ' || current_schema())"
"""First key of all of these locks: the services of a schema are those of one database."""

SERVING = 256
"""Second key of the lock that services share; below it lie those of images, by the first byte of their digests."""

IMAGE_SILENT_S = 120
"""Seconds between statements of the transaction that holds the lock of images, while an object store is slow."""

ADDING = 512
"""Second key, plus that byte, of the locks that transactions share which add rows of such images."""


class ImageHold:
    """A lock on images that is held. This one cannot be lost, as it is on a file."""

    def until_commit(self, connection: sa.Connection) -> None:
        """Keep removers out until a transaction that adds rows ends, even if the lock is lost meanwhile.

        Raises RolledBack where the lock was lost before: somebody may have removed what was written.
        """

    def await_commits(self) -> None:
        """Wait for transactions that add rows, whose lock may have been lost; raises StorageFailed."""

    def check(self) -> None:
        """Raise RolledBack where the lock was lost."""


class _ServerHold(ImageHold):
    """A lock of PostgreSQL, which is lost with its connection."""

    def __init__(self, holding: sa.Connection, key: int) -> None:
        self._holding, self._key = holding, {"key": ADDING + key}

    def until_commit(self, connection: sa.Connection) -> None:
        connection.execute(_SHARE, self._key)
        self.check()

    def await_commits(self) -> None:
        self._ask(_TAKE, self._key)

    def check(self) -> None:
        self._ask(_ANYTHING, {})

    def _ask(self, statement: sa.Executable, parameters: Mapping[str, int]) -> None:
        if self._holding.invalidated:
            raise RolledBack(AWAY.format("the connection with the lock of an image broke"))
        with translated("database", sent=False):
            self._holding.execute(statement, parameters)


_SHARE = sa.text(f"SELECT pg_advisory_xact_lock_shared({SCHEMA}, :key)")
_TAKE = sa.text(f"SELECT pg_advisory_xact_lock({SCHEMA}, :key)")
_ANYTHING = sa.text("SELECT 1")

ImageLock = Callable[[str], AbstractContextManager[ImageHold]]
"""From the first two digits of digests to a lock that writers and removers of such images hold in turn."""


def image_lock(database: Database, data: Path) -> ImageLock:
    """Locks of images that lie outside the data folder."""

    @contextmanager
    def by_file(first: str) -> Iterator[ImageHold]:
        with translated("images"), held(data / "image-locks" / first):
            yield ImageHold()

    @contextmanager
    def by_server(first: str) -> Iterator[ImageHold]:
        with translated("database", sent=False), database.open() as connection:
            transaction = connection.begin()
            lock = f"pg_advisory_xact_lock({SCHEMA}, {int(first, 16)})"
            connection.execute(dialect.bounded(IMAGE_SILENT_S, lock))
            try:
                yield _ServerHold(connection, int(first, 16))
            finally:
                with suppress(sa.exc.DBAPIError):  # the lock is lost, but what the block did is done
                    transaction.rollback()

    return by_file if dialect.is_file(database.engine) else by_server


POOLED = (
    "connections to the database server are handed from one transaction to the next, by a pooler in between: locks, "
    "settings and prepared statements of this service would be another's; have it pool by session, or name the server "
    "itself in REVISIT_DATABASE"
)


def refuse_pooler(database: Database) -> None:
    """Raise SetupError where a pooler lets two connections share one of PostgreSQL, as far as that can be seen.

    Services know of each other by locks that a connection holds between transactions.
    """
    if dialect.is_file(database.engine):
        return
    with database.open() as one, database.open() as other:
        served_by = []
        for connection in (one, other):
            served_by.append(connection.scalar(sa.text("SELECT pg_backend_pid()")))
            connection.rollback()
    if served_by[0] == served_by[1]:
        raise SetupError(POOLED)


def is_served(connection: sa.Connection) -> bool:
    """Whether a service has joined a PostgreSQL database; none can join before the transaction ends.

    False for a SQLite file, which has locks in its data folder instead.
    """
    if connection.dialect.name != "postgresql":
        return False
    return not connection.scalar(sa.text(f"SELECT pg_try_advisory_xact_lock({SCHEMA}, :key)"), {"key": SERVING})


class Peers:
    """The other services of a database.

    Parameters
    ----------
    database : Database
    """

    def __init__(self, database: Database) -> None:
        self._engine = database.engine
        self._connection: sa.Connection | None = None
        self._belongs = False

    @contextmanager
    def joined(self) -> Iterator[bool]:
        """Join the services of the database; yields whether there is no other, in which case none joins in the block.

        A SQLite file has one service: the lock of its data folder sees to that. A service whose connection broke does
        not count before it noticed (`rejoin`).
        """
        if dialect.is_file(self._engine):
            yield True
            return
        self.leave()
        self._belongs = True
        with translated("database"):
            self._connect()
            alone = bool(self._ask("pg_try_advisory_lock"))
            if not alone:  # wait for another that cleans up
                self._ask("pg_advisory_lock_shared")
        try:
            yield alone
        finally:
            if alone:
                with translated("database"):
                    self._ask("pg_advisory_lock_shared")
                    self._ask("pg_advisory_unlock")

    def rejoin(self) -> None:
        """Join again if the connection broke, as when the server was started anew; else do nothing."""
        if not self._belongs:
            return
        try:
            if self._connection is not None:
                self._connection.execute(sa.text("SELECT 1"))
                return
        except sa.exc.DBAPIError:
            self._drop()
        try:
            self._connect()
            if self._ask("pg_try_advisory_lock_shared"):
                return
        except sa.exc.DBAPIError as error:  # other uses of the database report the error
            log.debug("this service does not count among those of its database yet: %s", error)
        self._drop()  # another service cleans up at this moment

    def leave(self) -> None:
        """Leave them; a second time does nothing."""
        self._belongs = False
        self._drop()

    def _connect(self) -> None:
        self._connection = self._engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        self._connection.execute(sa.text("SET lock_timeout = 0"))

    def _drop(self) -> None:
        if self._connection is not None:
            self._connection.invalidate()
            self._connection.close()
            self._connection = None

    def _ask(self, function: str) -> object:
        assert self._connection is not None
        return self._connection.scalar(sa.text(f"SELECT {function}({SCHEMA}, :key)"), {"key": SERVING})
