"""Column types that mean the same on SQLite and PostgreSQL; tables and migrations share them."""

from datetime import UTC, datetime

import sqlalchemy as sa
from sqlalchemy.engine import Dialect
from sqlalchemy.types import TypeDecorator


class UtcDateTime(TypeDecorator[datetime]):
    """A moment, kept as UTC with microseconds and handed back with its zone.

    SQLite has no zones: it keeps text of fixed width, which compares as the moments do.
    """

    impl = sa.DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Refuse a time without a zone: which moment it means would depend on the machine."""
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError(f"a time needs a zone: {value!r}")
        return value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """The same moment, in UTC."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


def ordered_text() -> sa.Text:
    """Text that sorts by code point everywhere; PostgreSQL would sort by the language of the server."""
    return sa.Text().with_variant(sa.Text(collation="C"), "postgresql")


def big_key() -> sa.BigInteger:
    """An integer key given out by the database; SQLite does so only for a column called INTEGER."""
    return sa.BigInteger().with_variant(sa.Integer(), "sqlite")
