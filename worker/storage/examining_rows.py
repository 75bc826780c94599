"""Examines the rows of a database: every checksum, and what rows say of one another."""

import hashlib
import json
import sqlite3
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa

from schemas.errors import Damaged
from schemas.recipe import RankingConfig
from worker.storage import checksums, clock, damage, dialect, switching
from worker.storage.enrolment import keep_pairs
from worker.storage.filtering import metadata_pairs
from worker.storage.finding import BACKUP, REPAIR, Finding, Mend
from worker.storage.image_store import forgets
from worker.storage.rows import (
    VIEW_STATES,
    as_json,
    attributes_of,
    blur_of,
    find_recipe,
    has_whole_attributes,
    ranking_of,
)
from worker.storage.tables import (
    CALLS,
    CLOCK,
    COMPARISONS,
    DAY_SCORES,
    DESCRIPTIONS,
    JOBS,
    KEPT_QUERIES,
    KEYS,
    MAPS,
    METADATA_PAIRS,
    RECIPES,
    TOMBSTONES,
    VIEWS,
    VOCABULARIES,
)

MOST_REVISION = 2**62
"""No database comes this far; what is beyond is damage, as is text, which SQLite takes for more than any number."""

ROWS = 500
"""Rows of PostgreSQL in memory at a time: a kept query has an image."""

DISPENSABLE = {  # what it means that such a row is removed
    COMPARISONS: "it is made again in the background",
    JOBS: "what it had to do is queued again where it is needed",
    KEPT_QUERIES: "that query is no longer among the unknown ones",
    DAY_SCORES: "that day is left out when its place is examined for ageing",
    TOMBSTONES: "indexes are built anew at the next start",
    CALLS: "a repetition of that call is carried out instead of replayed",
}


def row_findings(engine: sa.Engine, owners: dict[str, str]) -> Iterator[Finding]:
    """Findings of all tables; fills `owners`: SHA-256 of each image to the views that need it, as text.

    All of them are read as they are at one moment: beside a service they would not fit each other otherwise.
    """
    with engine.connect() as plain, dialect.for_reading(plain) as connection, connection.begin():
        dialect.begin_reading(connection)
        yield from _clock(connection)
        yield from _recipes(connection)
        yield from _maps(connection)
        yield from _views(connection, owners)
        yield from _pairs(connection)
        yield from _descriptions(connection)
        for table in DISPENSABLE:
            for row in scan(connection, table):
                if isinstance(row, Finding):
                    yield row
                elif _is_damaged(table, row):
                    yield _dispensable(table, row)
        yield from _keys(connection)
        for row in scan(connection, VOCABULARIES):
            if isinstance(row, Finding):
                yield row
            elif hashlib.sha256(row.tensors).hexdigest() != row.digest:
                yield Finding(
                    f"vocabulary {row.digest}", "does not fit its digest", f"{BACKUP}, or train the map another one"
                )


def scan(connection: sa.Connection, table: sa.TableClause) -> Iterator[Any]:
    """All rows of a table that can be read, from both ends, and a Finding when that is not all."""
    if connection.dialect.name != "sqlite":
        yield from connection.execute(sa.select(table).execution_options(yield_per=ROWS))
        return
    last = None
    for order in ("rowid", "rowid DESC"):
        seen: set[object] = set()
        try:
            statement = sa.select(table, sa.text("rowid AS _rowid")).order_by(sa.text(order))
            for row in connection.execution_options(yield_per=1).execute(statement):
                number = row._mapping["_rowid"]
                if order != "rowid" and last is not None and number <= last:
                    break
                if order == "rowid":
                    last = number
                elif number in seen:
                    break
                seen.add(number)
                yield row
            return
        except (sa.exc.DatabaseError, sqlite3.Error, UnicodeError) as error:
            if order == "rowid":
                yield Finding(
                    f"table {table.name}", f"cannot be read in full ({getattr(error, 'orig', error)})", REPAIR
                )


def _is_damaged(table: sa.Table, row: sa.Row[Any]) -> bool:
    """Whether a row lacks its checksum or does not fit it."""
    return row.checksum is None or not checksums.is_whole(table, row)


def _clock(connection: sa.Connection) -> Iterator[Finding]:
    row = connection.execute(sa.select(CLOCK)).one_or_none()
    highest = max(
        connection.scalar(sa.select(sa.func.max(table.c.revision)).where(table.c.revision < MOST_REVISION)) or 0
        for table in (MAPS, DESCRIPTIONS, TOMBSTONES)
    )

    def mend(connection: sa.Connection) -> str:
        connection.execute(sa.delete(CLOCK))
        connection.execute(sa.insert(CLOCK).values(id=1, revision=int(highest) + 1))
        return f"set to {int(highest) + 1}"

    if row is None or _is_damaged(CLOCK, row):
        yield Finding("clock of revisions", "is missing or damaged", REPAIR, mend)
    elif row.revision < highest:
        yield Finding("clock of revisions", f"is at {row.revision}, behind revision {highest}", REPAIR, mend)


def _recipes(connection: sa.Connection) -> Iterator[Finding]:
    for row in connection.execute(sa.select(RECIPES)):
        try:
            find_recipe(connection, row.id)
        except Damaged:
            names = connection.scalars(sa.select(MAPS.c.name).where(MAPS.c.recipe == row.id))
            of = ", ".join(str(name) for name in names) or "none"
            yield Finding(f"recipe {row.id} of the maps {of}", "does not fit its id", f"cannot be mended: {BACKUP}")


def _maps(connection: sa.Connection) -> Iterator[Finding]:
    now = connection.scalar(sa.select(CLOCK.c.revision))
    last = (now,) if isinstance(now, int) else ()
    for row in connection.execute(sa.select(MAPS)):
        where = f"map {row.name!r}"
        if _is_damaged(MAPS, row):
            yield Finding(where, "its settings do not fit their checksum", REPAIR, _mend_map(row))
        elif not _are_in_order(row.anew, row.revision, *last) or not _are_in_order(row.edited, row.revision):
            of = f"{row.revision}, {row.anew} and {row.edited}"
            yield Finding(where, f"its revisions {of} cannot be", REPAIR, _mend_revision(row))
        elif row.shadow is not None and not _has_job(connection, row):
            yield Finding(where, "its shadow has no job", REPAIR, _mend_shadow(row))


def _are_in_order(*revisions: object) -> bool:
    """Whether what was read are revisions, none before the one it follows."""
    known = [0, *(one for one in revisions if isinstance(one, int))]
    return len(known) > len(revisions) and known == sorted(known)


def _has_job(connection: sa.Connection, row: sa.Row[Any]) -> bool:
    """Whether the job of a map's shadow is there, and can still end as one that is compared."""
    job = connection.execute(sa.select(JOBS).where(JOBS.c.id == row.shadow, JOBS.c.map_id == row.id)).one_or_none()
    if job is None or row.next_recipe is None or not checksums.is_whole(JOBS, job):
        return False
    return job.state not in ("failed", "cancelled")


def _mend_shadow(row: sa.Row[Any]) -> Mend:
    def mend(connection: sa.Connection) -> str:
        switching.end_shadow(connection, row.id, datetime.now(UTC))
        switching.stop(connection, row.id, row.next_recipe, datetime.now(UTC))
        return "it was discarded: the map keeps its recipe; begin it again"

    return mend


def _mend_map(row: sa.Row[Any]) -> Mend:
    def mend(connection: sa.Connection) -> str:
        ranking = ranking_of(str(row.ranking))
        values: dict[str, Any] = {"calibration": None, "ranking": ranking.model_dump_json(), "previous_recipe": None}
        values |= {**switching.NOTHING_NEXT, "created_at": datetime.now(UTC)}
        values["blur"] = as_json(list(blur_of(row))) if row.blur is not None else None
        if not isinstance(row.name, str) or not row.name.isascii() or not row.name.isprintable():
            values["name"] = f"rescued-{row.id}"
        known = connection.scalar(sa.select(sa.func.count()).select_from(RECIPES).where(RECIPES.c.id == row.recipe))
        if not known:
            by = sa.select(DESCRIPTIONS.c.recipe).where(DESCRIPTIONS.c.map_id == row.id)
            values["recipe"] = connection.scalar(by.limit(1)) or row.recipe
        connection.execute(sa.update(MAPS).where(MAPS.c.id == row.id).values(**values))
        switching.end_shadow(connection, row.id, datetime.now(UTC))
        clock.tick(connection, row.id)
        spared = "was kept" if ranking != RankingConfig() else "is the default one"
        return f"its ranking {spared} (PATCH /maps changes it), its own calibration was dropped"

    return mend


def _mend_revision(row: sa.Row[Any]) -> Mend:
    def mend(connection: sa.Connection) -> str:
        revision = clock.tick(connection, row.id)
        values = {"anew": revision, "edited": revision, "checksum": MAPS.c.checksum}
        connection.execute(sa.update(MAPS).where(MAPS.c.id == row.id).values(**values))
        return f"is at revision {revision} now"

    return mend


def _views(connection: sa.Connection, owners: dict[str, str]) -> Iterator[Finding]:
    maps = {row.id: row for row in connection.execute(sa.select(MAPS))}
    forgetting = {number for number in maps if forgets(connection, number)}
    described = {tuple(row) for row in connection.execute(sa.select(DESCRIPTIONS.c.seq, DESCRIPTIONS.c.recipe))}
    waits = sa.select(JOBS.c.seq, JOBS.c.recipe).where(JOBS.c.state.in_(switching.UNFINISHED))
    waiting = {tuple(row) for row in connection.execute(waits)}
    for row in scan(connection, VIEWS):
        if isinstance(row, Finding):
            yield row
            continue
        owner = maps.get(row.map_id)
        if row.state != "ready" or row.map_id not in forgetting:
            owners[str(row.sha256)] = f"view {row.id}"
        if owner is not None and owner.name is None:
            continue  # its map is being deleted
        where = f"view {row.id} of map {owner.name!r}" if owner is not None else f"view {row.id}"
        if owner is None or not has_whole_attributes(row):
            remedy = "enrol its image again, the very file, with its attributes, or delete it"
            yield Finding(where, "its attributes do not fit their checksum", remedy, _set_aside(row.seq))
            continue
        if row.state not in VIEW_STATES:
            yield Finding(where, f"its state {row.state!r} is none", REPAIR, _mend_state(row.seq))
            continue
        key = row.seq, owner.recipe
        right = {
            "ready": key in described,
            "pending": key in waiting,
            "failed": row.failure_code is not None and row.failure_detail is not None,
        }[row.state]
        if not right:
            yield Finding(where, f"is {row.state} without what that takes", REPAIR, _mend_state(row.seq))


def _set_aside(seq: int) -> Mend:
    def mend(connection: sa.Connection) -> str:
        damage.set_aside_views(connection, [seq], datetime.now(UTC))
        return "it is failed and left out of searches; its attributes cannot be mended: give them again"

    return mend


def _mend_state(seq: int) -> Mend:
    return lambda connection: damage.mend_state(connection, seq, datetime.now(UTC))


def _pairs(connection: sa.Connection) -> Iterator[Finding]:
    found: dict[int, set[str]] = {}
    for row in scan(connection, METADATA_PAIRS):
        if isinstance(row, Finding):
            yield row
        else:
            found.setdefault(row.seq, set()).add(row.pair)
    for row in scan(connection, VIEWS):
        if isinstance(row, Finding) or not has_whole_attributes(row):
            found.pop(getattr(row, "seq", -1), None)
        elif set(metadata_pairs(json.loads(row.metadata))) != found.pop(row.seq, set()):
            yield Finding(f"view {row.id}", "what finds it by its metadata is damaged", REPAIR, _mend_pairs(row.seq))
    for seq in found:
        yield Finding(f"metadata of row {seq} of views", "has no view", REPAIR, _drop_pairs(seq))


def _mend_pairs(seq: int) -> Mend:
    def mend(connection: sa.Connection) -> str:
        row = connection.execute(sa.select(VIEWS).where(VIEWS.c.seq == seq)).one()
        keep_pairs(connection, seq, attributes_of(row))
        return "made again from its metadata"

    return mend


def _drop_pairs(seq: int) -> Mend:
    def mend(connection: sa.Connection) -> str:
        connection.execute(sa.delete(METADATA_PAIRS).where(METADATA_PAIRS.c.seq == seq))
        return "removed"

    return mend


def _descriptions(connection: sa.Connection) -> Iterator[Finding]:
    named = {row.seq: row for row in connection.execute(sa.select(VIEWS.c.seq, VIEWS.c.id, VIEWS.c.map_id))}
    for key in connection.execute(sa.select(DESCRIPTIONS.c.seq, DESCRIPTIONS.c.recipe)).all():
        try:
            fault = damage.description_fault(connection, key.seq, key.recipe)
        except Damaged:
            continue  # its recipe is a finding by itself
        except sa.exc.DatabaseError as error:
            fault = f"rows, which cannot be read ({error.orig})"
        view = named.get(key.seq)
        if fault is not None:
            where = f"view {view.id}" if view is not None else f"row {key.seq} of descriptions"
            yield Finding(where, f"the {fault} of its description do not fit", REPAIR, _describe_again(*key))


def _describe_again(seq: int, recipe: str) -> Mend:
    def mend(connection: sa.Connection) -> str:
        told = damage.set_aside_descriptions(connection, {seq: ""}, recipe, datetime.now(UTC))
        return "it is failed and queued to be described again from its image" if told else "mended already"

    return mend


def _keys(connection: sa.Connection) -> Iterator[Finding]:
    """Damaged keys: never removed, since a service without any key asks nobody for one."""
    for row in scan(connection, KEYS):
        if isinstance(row, Finding):
            yield row
        elif _is_damaged(KEYS, row):

            def mend(connection: sa.Connection, key_id: str = row.id) -> str:
                connection.execute(sa.update(KEYS).where(KEYS.c.id == key_id).values(revoked_at=datetime.now(UTC)))
                return "revoked: make another with `./revisit keys create`"

            yield Finding(f"key {row.name}", "does not fit its checksum; it lets nobody in", REPAIR, mend)


def _dispensable(table: sa.Table, row: sa.Row[Any]) -> Finding:
    key = {column.name: getattr(row, column.name) for column in table.primary_key}

    def mend(connection: sa.Connection) -> str:
        connection.execute(sa.delete(table).where(*(table.c[name] == value for name, value in key.items())))
        if table is JOBS and row.seq is not None and row.state in switching.UNFINISHED:
            _mend_state(row.seq)(connection)
        return f"removed: {DISPENSABLE[table]}"

    where = f"row {' '.join(str(value) for value in key.values())} of {table.name}"
    return Finding(where, "does not fit its checksum", REPAIR, mend)
