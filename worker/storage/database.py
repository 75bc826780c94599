"""Transactions: context managers for reading and writing."""

from collections.abc import Iterator
from contextlib import contextmanager

import sqlalchemy as sa

from schemas.errors import Damaged, DiskFull
from worker.storage import dialect, sealing

DAMAGED = (
    "the file of the database is damaged ({}): whoever runs the service should stop it, then run "
    "`./revisit doctor --repair` or restore a backup"
)


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

    @contextmanager
    def reading(self) -> Iterator[sa.Connection]:
        """A transaction whose reads all see the same snapshot; raises Damaged when its file cannot be read."""
        try:
            with self.engine.connect() as connection:
                connection = dialect.for_reading(connection)
                with connection.begin():
                    yield connection
        except sa.exc.DBAPIError as error:
            if dialect.is_damaged(error):
                raise Damaged(DAMAGED.format(error.orig)) from error
            raise
        except UnicodeDecodeError as error:  # a message of SQLite's that quotes a damaged definition
            raise Damaged(DAMAGED.format("its definitions cannot be read")) from error

    @contextmanager
    def writing(self, *, in_turn: bool = True) -> Iterator[sa.Connection]:
        """A transaction that is committed durably at the end of the block, or rolled back when the block raises.

        Parameters
        ----------
        in_turn : bool
            Whether to exclude other writers; False only for writes without a new revision.

        Raises
        ------
        DiskFull, Damaged
        """
        try:
            with self.engine.connect() as connection:
                connection = dialect.for_writing(connection)
                with connection.begin():
                    if in_turn:
                        dialect.take_turn(connection)
                    sealing.begin(connection)
                    yield connection
                    sealing.seal(connection)
        except sa.exc.DBAPIError as error:
            if dialect.is_damaged(error):
                raise Damaged(DAMAGED.format(error.orig)) from error
            if dialect.is_full(error):
                raise DiskFull("the disk of the database is full; free some space or delete views") from error
            raise

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()
