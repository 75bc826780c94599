"""Transactions: the blocks in which everything is read and written."""

from collections.abc import Iterator
from contextlib import contextmanager

import sqlalchemy as sa

from schemas.errors import DiskFull
from worker.storage import dialect


class Database:
    """Connections to one database.

    Parameters
    ----------
    url : str
        SQLAlchemy URL.

    Raises
    ------
    SetupError
        Not a database revisit can use.
    """

    def __init__(self, url: str) -> None:
        self.engine = dialect.make_engine(url)

    @contextmanager
    def reading(self) -> Iterator[sa.Connection]:
        """A block whose reads all see the same moment."""
        with self.engine.connect() as connection:
            connection = dialect.for_reading(connection)
            with connection.begin():
                yield connection

    @contextmanager
    def writing(self, *, in_turn: bool = True) -> Iterator[sa.Connection]:
        """A block that is durable as a whole once left, or leaves nothing behind.

        Parameters
        ----------
        in_turn : bool
            False for writes that may overtake each other: none that gives out a revision.

        Raises
        ------
        DiskFull
        """
        try:
            with self.engine.connect() as connection:
                connection = dialect.for_writing(connection)
                with connection.begin():
                    if in_turn:
                        dialect.take_turn(connection)
                    yield connection
        except sa.exc.DBAPIError as error:
            if dialect.is_full(error):
                raise DiskFull("the disk of the database is full; free some space or delete views") from error
            raise

    def close(self) -> None:
        """Let go of all connections."""
        self.engine.dispose()
