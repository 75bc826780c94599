"""What the answers to calls with an Idempotency-Key, which are kept to be repeated, tell of views.

Of a deleted view they tell nothing but its id, of a changed one what it has now. Whoever deletes or changes a view sees
to the answers that are kept, in its own transaction; a call that ends sees to its own. All of them write in turn, so
that no answer is missed between them.
"""

import json
import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from typing import Any

import sqlalchemy as sa

from schemas.records import ViewAttributes
from schemas.wire_views import rfc3339
from worker.storage import checksums, clock, dialect
from worker.storage.database import Database
from worker.storage.rows import as_json, attributes_of, batches, has_whole_attributes
from worker.storage.tables import CALLS, VIEWS

FEW = 8
"""Deleted views up to which the database looks for their ids; for more all answers are read once."""

LATE = timedelta(minutes=5)
"""By how much the recorded start of a call may be too early: the call waited for its turn, or another clock gave it."""

DELETED: Mapping[str, Any] = {
    "place": None, "position": None, "captured_at": None, "metadata": {}, "filename": None, "description": None,
}  # fmt: skip
"""What a view that was deleted has in an answer that is repeated."""

SINCE_DELETED = "it concerned a view that was deleted since"

SINCE_CHANGED = "it concerned a view whose attributes were changed since"

Now = Mapping[str, ViewAttributes | None]
"""What views have now, by their ids; None: they were deleted."""

_ID = re.compile("[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}")
_VIEW = re.compile(f"(?:view |view '|views/|as )({_ID.pattern})")
"""A view in words, where an id may also be the name of a map or a file."""


class Answers:
    """Answers that are kept and tell of some views, found before these are changed, or deleted in portions.

    The answers of a whole day are searched once, outside of any writing transaction. A transaction that calls `tell` or
    `forget` searches only those of calls that ended since.

    Parameters
    ----------
    database : Database
    views : collection of str
        Their ids.

    Raises
    ------
    StorageFailed
    """

    def __init__(self, database: Database, views: Collection[str]) -> None:
        views = set(views)
        self._telling: dict[str, list[str]] = defaultdict(list)
        with database.reading() as connection:
            self._since = min(datetime.now(UTC), clock.shared_time(connection)) - LATE
            self._running = list(connection.scalars(sa.select(CALLS.c.key).where(CALLS.c.finished_at.is_(None))))
            for key, named in _telling(connection, views):
                for view in named:
                    self._telling[view].append(key)

    def forget(self, connection: sa.Connection, views: Collection[str]) -> None:
        """Leave nothing of views but their ids in the answers, in the writing transaction that deletes these views."""
        self.tell(connection, dict.fromkeys(views))

    def tell(self, connection: sa.Connection, views: Now) -> None:
        """Rewrite the answers to say what views have now, in the writing transaction that changes these views."""
        keys = {key for view in views for key in self._telling.get(view, ())}
        since = [CALLS.c.begun_at >= self._since]
        since += [CALLS.c.key.in_(portion) for portion in batches(self._running)]
        for ended in since:
            keys |= {key for key, _ in _telling(connection, set(views), ended)}
        for portion in batches(keys):
            _retell(connection, portion, views)


def as_now(connection: sa.Connection, body: bytes, ids: Collection[str]) -> bytes:
    """An answer that is about to be kept, with what the views that it names have now; `ids`: see `named`."""
    now: dict[str, ViewAttributes | None] = dict.fromkeys(ids)
    for portion in batches(ids):
        for row in connection.execute(sa.select(VIEWS).where(VIEWS.c.id.in_(portion))):
            if has_whole_attributes(row):
                now[row.id] = attributes_of(row)
            else:
                del now[row.id]
    return retold(body, now, told_lately=True)


def named(body: bytes) -> set[str]:
    """Ids in an answer, of views and of others."""
    return set(_ID.findall(body.decode(errors="replace")))


def retold(body: bytes, views: Now, *, told_lately: bool = False) -> bytes:
    """The answer to an enrolment, of one image or of several, brought up to date with what views have now.

    Parameters
    ----------
    body : bytes
        The answer, JSON. It is returned as it is where nothing changes.
    views : mapping of str to ViewAttributes or None
        None: deleted.
    told_lately : bool
        The call is only ending. Sentences that name a view as it is called now stay, and the ids in `views` were taken
        from the answer's text, so that some may not be of views.
    """
    answer = json.loads(body)
    before = _text(answer)
    for one in (answer, *answer.get("views", ())):
        view = one.get("view")
        if isinstance(view, dict) and view["id"] in views:
            _tell(view, views[view["id"]])
        for warning in one.get("warnings", ()):
            warning["detail"] = _detail(warning["detail"], {warning["view"]}, views, told_lately)
    for refused in (answer, *answer.get("errors", ())):
        if detail := refused.get("detail"):
            ids = _VIEW.findall(detail) if told_lately else _ID.findall(detail)
            refused["detail"] = _detail(detail, ids, views, told_lately)
    after = _text(answer)
    return body if after == before else after


def _detail(detail: str, ids: Iterable[str | None], views: Now, told_lately: bool) -> str:
    """A sentence that names views, or instead of it only that one of them was deleted or changed."""
    concerned = [(one, views[one]) for one in ids if one is not None and one in views]
    if any(attributes is None for _, attributes in concerned):
        return SINCE_DELETED
    if any(not told_lately or not _is_named(detail, one, now) for one, now in concerned if now is not None):
        return SINCE_CHANGED
    return detail


def _is_named(detail: str, view_id: str, now: ViewAttributes) -> bool:
    """Whether a view is called what it is called now, or by its id alone; see `worker.service.duplicates.named`."""
    name = now.place or now.filename or now.metadata.get("file")
    return f"(view {view_id})" not in detail or f"{name!r} (view {view_id})" in detail


def _tell(view: dict[str, Any], now: ViewAttributes | None) -> None:
    """Give a view in an answer what it has now. Of a deleted one its id and what its image is like stay."""
    if now is None:
        view |= DELETED
        view["image"]["sha256"] = "0" * 64
        return
    position = asdict(now.position)
    has = {
        "place": now.place,
        "position": None if all(value is None for value in position.values()) else position,
        "captured_at": None if now.captured_at is None else rfc3339(now.captured_at),
        "metadata": dict(now.metadata),
        "filename": now.filename,
    }
    if _bare({name: view.get(name) for name in has}) != _bare(has):
        view |= has


def _bare(has: Mapping[str, Any]) -> str:
    """What a view has, as a text to compare: equal for equal attributes."""
    position = has["position"]
    known = position and {name: value for name, value in position.items() if value is not None}
    return as_json({**has, "position": known})


def _text(answer: Any) -> bytes:
    return json.dumps(answer, ensure_ascii=False, separators=(",", ":")).encode()


def _telling(
    connection: sa.Connection, views: set[str], *which: sa.ColumnElement[bool]
) -> Iterable[tuple[str, set[str]]]:
    """Keys of the answers that name some of these views, and which."""
    kept = sa.select(CALLS.c.key, CALLS.c.body).where(CALLS.c.finished_at.is_not(None), *which)
    if len(views) <= FEW:
        kept = kept.where(sa.or_(sa.false(), *(_holds(connection.engine, view) for view in views)))
    for row in connection.execute(kept.execution_options(yield_per=100)):
        if some := named(row.body or b"") & views:
            yield row.key, some


def _holds(engine: sa.Engine, view_id: str) -> sa.ColumnElement[bool]:
    """SQL condition that the id of a view stands in an answer."""
    wanted = sa.literal(view_id.encode(), sa.LargeBinary)
    if dialect.is_file(engine):
        return sa.func.instr(CALLS.c.body, wanted) > 0
    return sa.func.position(wanted.op("IN")(CALLS.c.body)) > 0


def _retell(connection: sa.Connection, keys: Collection[str], views: Now) -> None:
    """Change what the answers of some calls tell of some views; one that is damaged goes as a whole."""
    for row in list(connection.execute(sa.select(CALLS).where(CALLS.c.key.in_(keys)))):
        of = CALLS.c.key == row.key
        if row.finished_at is None or not checksums.is_whole(CALLS, row, row.checksum):
            connection.execute(sa.delete(CALLS).where(of, CALLS.c.finished_at.is_not(None)))
        else:
            connection.execute(sa.update(CALLS).where(of).values(body=retold(row.body, views)))
