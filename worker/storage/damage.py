"""Damaged rows: what they are, and how they are set aside so that everything else is served.

A description that does not fit its checksum is removed, its view is `failed` with the code ``damaged`` and leaves the
index, and a job describes it again from its image. A view whose attributes are damaged is `failed` until they are given
again: nothing else has them.
"""

import logging
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np
import sqlalchemy as sa

from schemas.errors import Damaged, RevisitError
from schemas.recipe import DescriptionRecipe
from worker.storage import checksums, clock, packing, switching
from worker.storage.rows import VIEW_STATES, description_facts, find_recipe, has_whole_attributes
from worker.storage.tables import APPEARANCES, CELLS, DESCRIPTIONS, KEYPOINTS, MAPS, TOMBSTONES, VECTORS, VIEWS

log = logging.getLogger("revisit.storage")

CODE = Damaged.code

ATTRIBUTES = (
    "its stored attributes do not fit their checksum and are not shown; enrol its image again, the very file, with its "
    "place, position, time and metadata: its SHA-256 is {sha256:.64}, by which it lies in the folder pictures. "
    "GET /views/{id}/image gives it without EXIF and the like, which may be another file"
)
DESCRIPTION = "its {what} did not fit the checksum; it is described again from its image"


class Quarantine:
    """Sets damaged rows aside, in a transaction of its own; that it cannot is logged, not raised.

    Parameters
    ----------
    database : Database
        Offers `writing`.
    """

    def __init__(self, database: Any) -> None:
        self._database = database

    def descriptions(self, found: Mapping[int, str], recipe: str) -> None:
        """Set aside descriptions by a recipe; `found` says which part of each is damaged, by sequence number."""
        self._do(lambda connection: set_aside_descriptions(connection, found, recipe, datetime.now(UTC)), found)

    def views(self, seqs: Iterable[int]) -> None:
        """Set aside views with damaged attributes."""
        which = list(seqs)
        self._do(lambda connection: set_aside_views(connection, which, datetime.now(UTC)), which)

    def _do(self, change: Any, which: Iterable[int]) -> None:
        which = list(which)
        if not which:
            return
        try:
            with self._database.writing() as connection:
                told = change(connection)
        except (RevisitError, sa.exc.SQLAlchemyError):
            log.exception("damaged rows of the views with the sequence numbers %s could not be set aside", which)
        else:
            for line in told:
                log.error("%s", line)


def set_aside_descriptions(
    connection: sa.Connection, found: Mapping[int, str], recipe: str, now: datetime
) -> list[str]:
    """Remove damaged descriptions and queue their views to be described again; returns what to tell.

    Those that are whole by now, because they were described again meanwhile, are left.
    """
    told = []
    for seq, what in found.items():
        view = connection.execute(_owner(seq)).one_or_none()
        fault = None if view is None else description_fault(connection, seq, recipe)
        if view is None or fault is None:
            continue
        what = what or fault
        connection.execute(sa.delete(DESCRIPTIONS).where(DESCRIPTIONS.c.seq == seq, DESCRIPTIONS.c.recipe == recipe))
        if recipe == view.recipe:
            _leave_index(connection, view, DESCRIPTION.format(what=what))
        if recipe in (view.recipe, view.next_recipe) and switching.unfinished_job(connection, seq, recipe) is None:
            switching.queue(connection, view.map_id, [seq], recipe, now, background=True)
        told.append(f"view {view.id} of map {view.name}: {DESCRIPTION.format(what=what)}")
    return told


def mend_state(connection: sa.Connection, seq: int, now: datetime) -> str:
    """Set the state of a view by what there is of it; returns what was done."""
    view = connection.execute(_owner(seq)).one()
    of = DESCRIPTIONS.c.seq == seq, DESCRIPTIONS.c.recipe == view.recipe
    if connection.execute(sa.select(DESCRIPTIONS.c.seq).where(*of)).first() is not None:
        state, done = "ready", "its state was set right"
    else:
        state, done = "pending", "it is queued to be described again"
        if switching.unfinished_job(connection, seq, view.recipe) is None:
            switching.queue(connection, view.map_id, [seq], view.recipe, now, background=True)
    values = {"state": state, "failure_code": None, "failure_detail": None}
    connection.execute(sa.update(VIEWS).where(VIEWS.c.seq == seq).values(**values))
    return done


def set_aside_views(connection: sa.Connection, seqs: Iterable[int], now: datetime) -> list[str]:
    """Mark views with damaged attributes failed and take them out of the index; returns what to tell.

    A view of which only the state is damaged gets it back.
    """
    told = []
    for seq in seqs:
        row = connection.execute(sa.select(VIEWS).where(VIEWS.c.seq == seq)).one_or_none()
        if row is None or (row.state == "failed" and row.failure_code == CODE):
            continue
        if has_whole_attributes(row):
            if row.state not in VIEW_STATES:
                told.append(f"view {row.id}: its state {row.state!r} is none; {mend_state(connection, seq, now)}")
            continue
        view = connection.execute(_owner(seq)).one_or_none()
        if view is None:
            continue
        connection.execute(sa.delete(DESCRIPTIONS).where(DESCRIPTIONS.c.seq == seq))
        detail = ATTRIBUTES.format(id=view.id, sha256=str(row.sha256))
        _leave_index(connection, view, detail)
        told.append(f"view {view.id} of map {view.name}: {detail}")
    return told


def _owner(seq: int) -> sa.Select[Any]:
    columns = (VIEWS.c.id, VIEWS.c.seq, VIEWS.c.map_id, MAPS.c.name, MAPS.c.recipe, MAPS.c.next_recipe)
    return sa.select(*columns).join(MAPS, MAPS.c.id == VIEWS.c.map_id).where(VIEWS.c.seq == seq)


def _leave_index(connection: sa.Connection, view: sa.Row[Any], detail: str) -> None:
    """Fail a view, and have every index drop it."""
    failed = {"state": "failed", "failure_code": CODE, "failure_detail": detail}
    connection.execute(sa.update(VIEWS).where(VIEWS.c.seq == view.seq).values(**failed))
    bury(connection, view.map_id, [view.seq])


def bury(connection: sa.Connection, map_id: int, seqs: Iterable[int]) -> int:
    """Leave tombstones, so that every index drops these views; returns the map's new revision."""
    revision = clock.tick(connection, map_id)
    rows = [{"seq": seq, "map_id": map_id, "revision": revision} for seq in seqs]
    connection.execute(sa.delete(TOMBSTONES).where(TOMBSTONES.c.seq.in_([row["seq"] for row in rows])))
    connection.execute(sa.insert(TOMBSTONES), rows)
    return revision


def description_fault(connection: sa.Connection, seq: int, recipe: str) -> str | None:
    """Which part of a stored description is damaged or missing, or None, also when there is no description at all."""
    of = DESCRIPTIONS.c.seq == seq, DESCRIPTIONS.c.recipe == recipe
    row = connection.execute(sa.select(DESCRIPTIONS).where(*of)).one_or_none()
    if row is None:
        return None
    if checksums.of_values(description_facts(row)) != row.checksum:
        return "facts"
    by = find_recipe(connection, recipe)
    for table, check in (
        (VECTORS, lambda body: vectors_fault(body, by)),
        (APPEARANCES, lambda body: packing.unpack_appearance(body, (1.0, 1.0))),
        (CELLS, packing.unpack_cells),
        (KEYPOINTS, packing.unpack_keypoints),
    ):
        part = connection.execute(
            sa.select(table.c.body, table.c.checksum).where(table.c.seq == seq, table.c.recipe == recipe)
        ).one_or_none()
        if part is None:
            if table is not KEYPOINTS or by.parameters.local_features is not None:
                return table.name
            continue
        if checksums.of_body(seq, recipe, part.body) != part.checksum:
            return table.name
        try:
            check(part.body)
        except ValueError:
            return table.name
    return None


def vectors_fault(body: bytes, recipe: DescriptionRecipe) -> None:
    """Raises ValueError for vectors of another length than the recipe's, or with values that are no numbers."""
    if len(body) != vectors_size(recipe) or not np.isfinite(packing.unpack_floats(body)).all():
        raise ValueError("these are no vectors of the recipe")


def vectors_size(recipe: DescriptionRecipe) -> int:
    """Bytes of a view's vectors by a recipe."""
    return 4 * sum(channel.length for channel in recipe.parameters.channels.values())
