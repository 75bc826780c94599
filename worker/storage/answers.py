"""Stored answers to calls with an Idempotency-Key, kept up to date with the views that they name.

A stored answer says nothing of a deleted view but its id, and gives a changed view the attributes that it has now. A
transaction that deletes or changes views rewrites the stored answers that name them; a transaction that stores an
answer first brings it up to date. All of them write in turn, so that no answer is missed between them.
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
"""Up to this many views the database looks for each id in the answers; for more, all answers are read once."""

LATE = timedelta(minutes=5)
"""How much too early the recorded start of a call may be: it waited for its turn, or another clock gave the time."""

DELETED: Mapping[str, Any] = {
    "place": None, "position": None, "captured_at": None, "metadata": {}, "filename": None, "description": None,
}  # fmt: skip
"""Fields that a deleted view has in a stored answer."""

SINCE_DELETED = "it concerned a view that was deleted since"

SINCE_CHANGED = "it concerned a view whose attributes were changed since"

CurrentAttributes = Mapping[str, ViewAttributes | None]
"""The attributes that views have now, by their ids; None: the view was deleted."""

_ID = re.compile("[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}")
_VIEW = re.compile(f"(?:view |view '|views/|as )({_ID.pattern})")
"""A view that a sentence names. Other ids in it may be names of maps or files."""


class StoredAnswers:
    """The stored answers that name some views, found before these views are changed, or deleted in portions.

    All stored answers, those of a whole day, are searched once, outside of any writing transaction. The transaction
    that calls `update` or `forget` searches only those that were stored since.

    Parameters
    ----------
    database : Database
    views : collection of str
        Ids of the views.

    Raises
    ------
    StorageFailed
    """

    def __init__(self, database: Database, views: Collection[str]) -> None:
        views = set(views)
        self._keys: dict[str, list[str]] = defaultdict(list)
        with database.reading() as connection:
            self._since = min(datetime.now(UTC), clock.shared_time(connection)) - LATE
            self._running = list(connection.scalars(sa.select(CALLS.c.key).where(CALLS.c.finished_at.is_(None))))
            for key, named in _naming(connection, views):
                for view in named:
                    self._keys[view].append(key)

    def forget(self, connection: sa.Connection, views: Collection[str]) -> None:
        """Leave nothing of views but their ids in the answers, in the writing transaction that deletes these views."""
        self.update(connection, dict.fromkeys(views))

    def update(self, connection: sa.Connection, views: CurrentAttributes) -> None:
        """Rewrite the answers to have what views have now, in the writing transaction that changes these views."""
        keys = {key for view in views for key in self._keys.get(view, ())}
        since = [CALLS.c.begun_at >= self._since]
        since += [CALLS.c.key.in_(portion) for portion in batches(self._running)]
        for ended in since:
            keys |= {key for key, _ in _naming(connection, set(views), ended)}
        for portion in batches(keys):
            _update(connection, portion, views)


def current(connection: sa.Connection, body: bytes, ids: Collection[str]) -> bytes:
    """An answer that is about to be stored, with what the views that it names have now; `ids` are those of `ids_in`."""
    now: dict[str, ViewAttributes | None] = dict.fromkeys(ids)
    for portion in batches(ids):
        for row in connection.execute(sa.select(VIEWS).where(VIEWS.c.id.in_(portion))):
            if has_whole_attributes(row):
                now[row.id] = attributes_of(row)
            else:
                del now[row.id]
    return updated(body, now, ending=True)


def ids_in(body: bytes) -> set[str]:
    """All ids in an answer, whether of views or not."""
    return set(_ID.findall(body.decode(errors="replace")))


def updated(body: bytes, views: CurrentAttributes, *, ending: bool = False) -> bytes:
    """The answer to an enrolment, of one image or of several, with what views have now.

    Parameters
    ----------
    body : bytes
        The answer, JSON. It is returned as it is where nothing changes.
    views : mapping of str to ViewAttributes or None
        None: deleted.
    ending : bool
        Whether the call is only ending. Then a sentence stays that names a view as it is called now, and `views` has
        all ids of the answer's text, of which some may not be of views.
    """
    answer = json.loads(body)
    before = _text(answer)
    for one in (answer, *answer.get("views", ())):
        view = one.get("view")
        if isinstance(view, dict) and view["id"] in views:
            _set_attributes(view, views[view["id"]])
        for warning in one.get("warnings", ()):
            warning["detail"] = _detail(warning["detail"], {warning["view"]}, views, ending)
    for refused in (answer, *answer.get("errors", ())):
        if detail := refused.get("detail"):
            ids = _VIEW.findall(detail) if ending else _ID.findall(detail)
            refused["detail"] = _detail(detail, ids, views, ending)
    after = _text(answer)
    return body if after == before else after


def _detail(detail: str, ids: Iterable[str | None], views: CurrentAttributes, ending: bool) -> str:
    """A sentence that names views; instead of it only that one of them was deleted or changed, where one was."""
    concerned = [(one, views[one]) for one in ids if one is not None and one in views]
    if any(attributes is None for _, attributes in concerned):
        return SINCE_DELETED
    if any(not ending or not _is_named(detail, one, now) for one, now in concerned if now is not None):
        return SINCE_CHANGED
    return detail


def _is_named(detail: str, view_id: str, now: ViewAttributes) -> bool:
    """Whether a view is called what it is called now, or by its id alone; see `worker.service.duplicates.named`."""
    name = now.place or now.filename or now.metadata.get("file")
    return f"(view {view_id})" not in detail or f"{name!r} (view {view_id})" in detail


def _set_attributes(view: dict[str, Any], now: ViewAttributes | None) -> None:
    """Give a view in an answer the attributes that it has now; a deleted one keeps its id and the size of its image."""
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
    if _comparable({name: view.get(name) for name in has}) != _comparable(has):
        view |= has


def _comparable(has: Mapping[str, Any]) -> str:
    """The attributes of a view as text that is equal for equal attributes."""
    position = has["position"]
    known = position and {name: value for name, value in position.items() if value is not None}
    return as_json({**has, "position": known})


def _text(answer: Any) -> bytes:
    return json.dumps(answer, ensure_ascii=False, separators=(",", ":")).encode()


def _naming(
    connection: sa.Connection, views: set[str], *which: sa.ColumnElement[bool]
) -> Iterable[tuple[str, set[str]]]:
    """The keys of the stored answers that name any of these views, each with the views that it names."""
    kept = sa.select(CALLS.c.key, CALLS.c.body).where(CALLS.c.finished_at.is_not(None), *which)
    if len(views) <= FEW:
        kept = kept.where(sa.or_(sa.false(), *(_contains(connection.engine, view) for view in views)))
    for row in connection.execute(kept.execution_options(yield_per=100)):
        if some := ids_in(row.body or b"") & views:
            yield row.key, some


def _contains(engine: sa.Engine, view_id: str) -> sa.ColumnElement[bool]:
    """SQL condition that the id of a view stands in an answer."""
    wanted = sa.literal(view_id.encode(), sa.LargeBinary)
    if dialect.is_file(engine):
        return sa.func.instr(CALLS.c.body, wanted) > 0
    return sa.func.position(wanted.op("IN")(CALLS.c.body)) > 0


def _update(connection: sa.Connection, keys: Collection[str], views: CurrentAttributes) -> None:
    """Rewrite the stored answers with these keys; a damaged one is deleted."""
    for row in list(connection.execute(sa.select(CALLS).where(CALLS.c.key.in_(keys)))):
        of = CALLS.c.key == row.key
        if row.finished_at is None or not checksums.is_whole(CALLS, row):
            connection.execute(sa.delete(CALLS).where(of, CALLS.c.finished_at.is_not(None)))
        else:
            connection.execute(sa.update(CALLS).where(of).values(body=updated(row.body, views)))
