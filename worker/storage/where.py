"""Conditions on views as SQL, with the same meaning in SQLite and PostgreSQL: each is true or false, never unknown."""

from collections.abc import Sequence
from operator import ge, gt, le, lt
from typing import Any

import sqlalchemy as sa
from sqlalchemy.dialects.postgresql import JSONB

from schemas.where import AllOf, AnyOf, Begins, Compared, Is, Not, Number, Predicate, Value
from worker.storage.rows import as_json
from worker.storage.tables import VIEWS

_COMPARE = {"$gt": gt, "$gte": ge, "$lt": lt, "$lte": le}

Clause = sa.ColumnElement[bool]


def fulfilling(one: Predicate, dialect: str) -> Clause:
    """The views of which a condition holds.

    Parameters
    ----------
    one : Predicate
    dialect : str
        ``sqlite`` or ``postgresql``.
    """
    if isinstance(one, AllOf):
        return sa.and_(*(fulfilling(part, dialect) for part in one.conditions))
    if isinstance(one, AnyOf):
        return sa.or_(*(fulfilling(part, dialect) for part in one.conditions))
    if isinstance(one, Not):
        return sa.not_(fulfilling(one.condition, dialect))
    field = _Field(one.path, dialect)
    if isinstance(one, Is):
        return sa.or_(*(_known(field.of(value) == field.bound(value)) for value in one.values))
    if isinstance(one, Compared):
        return _known(_COMPARE[one.operator](field.of(one.bound), field.bound(one.bound)))
    if isinstance(one, Begins):
        if dialect == "postgresql":  # where a database has no encoding, what it counts are bytes
            return _known(sa.func.starts_with(field.of(one.prefix), one.prefix))
        return _known(sa.func.substr(field.of(one.prefix), 1, len(one.prefix)) == one.prefix)
    return field.exists()


def _known(comparison: sa.ColumnElement[bool]) -> Clause:
    return sa.func.coalesce(comparison, sa.false())


class _Field:
    """A column of `views`, or what lies at a path in its metadata.

    Parameters
    ----------
    path : sequence of str
    dialect : str
    """

    def __init__(self, path: Sequence[str], dialect: str) -> None:
        self._column = None if path[0] == "metadata" else VIEWS.c[path[0]]
        self._keys = path[1:]
        self._postgresql = dialect == "postgresql"
        # What is no JSON any more is damaged, and has no fields; the doctor finds it. PostgreSQL sees to its own pages.
        whole = sa.case((sa.func.json_valid(VIEWS.c.metadata) == 1, VIEWS.c.metadata), else_=None)
        self._json = sa.cast(VIEWS.c.metadata, JSONB) if self._postgresql else whole

    def exists(self) -> Clause:
        """Whether there is anything, null of JSON included."""
        return (self._type() if self._column is None else self._column).is_not(None)

    def of(self, like: Value) -> sa.ColumnElement[Any]:
        """The field where it is of the type of a value, else NULL; true and false are 1 and 0."""
        if self._column is not None:
            return self._column
        return sa.case((self._type().in_(self._kinds(like)), self._extracted(like)), else_=None)

    def bound(self, value: Value) -> sa.ColumnElement[Any]:
        """A value, as `of` can be compared with it."""
        if self._column is not None:
            return sa.literal(value, self._column.type)
        if isinstance(value, bool):
            return sa.literal(int(value))
        if isinstance(value, Number) and self._postgresql:  # JSON's numbers may be larger than float64
            return sa.cast(sa.literal(repr(value)), sa.Numeric)
        # SQLite reads larger integers of JSON as float64.
        return sa.literal(float(value) if isinstance(value, int) and abs(value) >= 2**63 else value)

    def _kinds(self, like: Value) -> tuple[str, ...]:
        """What the database calls the type of a value."""
        if isinstance(like, bool):
            return ("boolean",) if self._postgresql else ("true", "false")
        if isinstance(like, Number):
            return ("number",) if self._postgresql else ("integer", "real")
        return ("string",) if self._postgresql else ("text",)

    def _type(self) -> sa.ColumnElement[str]:
        if self._postgresql:
            return sa.func.jsonb_typeof(sa.func.jsonb_extract_path(self._json, *self._keys))
        return sa.func.json_type(self._json, self._path())

    def _extracted(self, like: Value) -> sa.ColumnElement[Any]:
        if not self._postgresql:
            return sa.func.json_extract(self._json, self._path())
        text = sa.func.jsonb_extract_path_text(self._json, *self._keys)
        if isinstance(like, bool):
            return sa.cast(sa.cast(text, sa.Boolean), sa.Integer)
        return sa.cast(text, sa.Numeric) if isinstance(like, Number) else text

    def _path(self) -> str:
        """The path, escaped as the stored JSON is, to which SQLite compares it letter by letter."""
        return "$" + "".join(f".{as_json(key)}" for key in self._keys)
