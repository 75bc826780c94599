"""Shadows: a map's views are described by another recipe, answers are compared, and the map waits to be told.

``maps.shadow`` names the job, of the kind ``shadow``. It runs while views are described, then waits to be claimed by a
worker that compares answers, and is done when they are. ``maps.next_recipe`` stays until the map is told to change over
or to discard it: meanwhile each new view is described by both recipes, as during every recipe switch.
"""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

import sqlalchemy as sa
from uuid6 import uuid7

from schemas.errors import Conflict, NotFound
from schemas.recipe import MapRecipe
from schemas.records import JobRecord, MapClaim
from schemas.shadow import ShadowRecord, ShadowState
from worker.storage import switching
from worker.storage.image_store import forgets
from worker.storage.import_jobs import ImportJobs
from worker.storage.map_jobs import held, record_of, refuse_changed, refuse_second
from worker.storage.rows import as_json, batches, find_map, find_recipe, inserting, keep_recipe, ranking_of
from worker.storage.tables import JOBS, MAPS, VIEWS

SAME = (
    "the map {0!r} is described by this recipe already, so that there is nothing to compare; PATCH /maps/{0} changes "
    "its ranking, at once and back"
)


class ShadowJobs(ImportJobs):
    """Jobs of all kinds, imports, and the shadows of maps."""

    def begin_shadow(
        self, name: str, recipe: MapRecipe, wanted: int, now: datetime, made_from: MapRecipe | None = None
    ) -> JobRecord:
        """Begin to describe a map's views by another recipe, to which the map changes over only when it is told.

        Parameters
        ----------
        name : str
        recipe : MapRecipe
        wanted : int
            Number of queries that are then answered by both.
        now : datetime
        made_from : MapRecipe or None
            The map's recipe, of which `recipe` has what is not changed.

        Raises
        ------
        NotFound
        RecipeChanged
            The map no longer has the recipe `made_from`.
        Conflict
            Another job of the map has not finished, it has a shadow or this very recipe, or its images are not kept.
        """
        with self._database.writing() as connection:
            row = find_map(connection, name)
            refuse_second(connection, row)
            refuse_changed(connection, row, made_from)
            if row.recipe == recipe.description.id:
                raise Conflict(SAME.format(name))
            if forgets(connection, row.id):  # a view enrolled meanwhile could not be described twice
                raise Conflict(switching.NO_IMAGES.format(name))
            kept, job = keep_recipe(connection, recipe.description), str(uuid7())
            new = {"id": job, "kind": "shadow", "map_id": row.id, "recipe": kept, "background": True, "attempts": 0}
            told = {"state": "running", "created_at": now, "result": as_json({"wanted": int(wanted)})}
            connection.execute(inserting(JOBS), {**new, **told})
            switching.begin(connection, row, kept, recipe.ranking.model_dump_json(), job, now, shadow=True)
            return record_of(connection, job)

    def shadow(self, name: str) -> ShadowRecord:
        """The shadow of a map; raises NotFound."""
        with self._database.reading() as connection:
            return _shadow(connection, find_map(connection, name))

    def finish_shadow(self, claim: MapClaim, result: Mapping[str, Any], now: datetime) -> None:
        """End the comparison of a claimed job: its shadow is ready; raises LeaseLost.

        Rows of the table that name views which were deleted while answers were compared are left out.
        """
        with self._database.writing() as connection:
            job = held(connection, claim)
            done = {"state": "done", "finished_at": now, "token": None, "progress_done": job.progress_total}
            kept = as_json(_of_present_views(connection, result))
            connection.execute(sa.update(JOBS).where(JOBS.c.number == job.number).values(**done, result=kept))

    def switch_to_shadow(self, name: str, now: datetime) -> JobRecord:
        """Change a map over to its shadow, of whose table the totals stay.

        Returns the job of the kind ``recipe``, which waits, if at all, for views that were enrolled a moment ago.

        Raises
        ------
        NotFound
        Conflict
            The shadow is not ready.
        """
        with self._database.writing() as connection:
            row = find_map(connection, name)
            shadow = _shadow(connection, row)
            if shadow.state != "ready":
                raise Conflict(
                    f"the shadow of the map {name!r} is {shadow.state}; GET /maps/{name}/shadow says when it is ready"
                )
            new = {"id": str(uuid7()), "kind": "recipe", "map_id": row.id, "recipe": row.next_recipe}
            told = {"background": True, "state": "running", "attempts": 1, "created_at": now}
            connection.execute(inserting(JOBS), {**new, **told})
            connection.execute(sa.update(MAPS).where(MAPS.c.id == row.id).values(shadow=None))
            switching.drop_rows(connection, shadow.job.id)
            switching.finish_if_done(connection, row.id, now)
            return record_of(connection, new["id"])

    def discard_shadow(self, name: str, now: datetime) -> JobRecord:
        """Discard the shadow of a map, ready or not; of its table the totals stay. Returns its job; raises NotFound."""

        def discard(connection: sa.Connection) -> JobRecord:
            row = find_map(connection, name)
            shadow = _shadow(connection, row)
            switching.stop(connection, row.id, row.next_recipe, now)
            switching.end_shadow(connection, row.id, now)
            switching.drop_rows(connection, shadow.job.id)
            return record_of(connection, shadow.job.id)

        return self._database.freeing(discard)  # its descriptions go next


def _of_present_views(connection: sa.Connection, table: Mapping[str, Any]) -> dict[str, Any]:
    """A shadow's table without the rows that name a view which is not there; its totals stay."""
    rows = [(row, switching.views_of_row(row)) for row in table.get("queries", ())]
    present: set[str] = set()
    for portion in batches(set().union(*(views for _, views in rows))):
        present |= set(connection.scalars(sa.select(VIEWS.c.id).where(VIEWS.c.id.in_(portion))))
    kept = [row for row, views in rows if views <= present]
    return {**table, "queries": kept} if len(kept) < len(rows) else dict(table)


def _shadow(connection: sa.Connection, row: sa.Row[Any]) -> ShadowRecord:
    """The shadow of a map, from its row; raises NotFound."""
    if row.shadow is None or row.next_recipe is None:
        raise NotFound("shadow of the map", row.name, f"POST /maps/{row.name}/recipe with `shadow` begins one")
    job = connection.execute(sa.select(JOBS).where(JOBS.c.id == row.shadow)).one_or_none()
    state: ShadowState = "comparing"
    if job is not None and job.state == "done":
        state = "ready"
    elif job is not None and job.state == "running" and job.token is None:
        state = "describing"
    recipe = MapRecipe(description=find_recipe(connection, row.next_recipe), ranking=ranking_of(row.next_ranking))
    return ShadowRecord(row.name, state, record_of(connection, row.shadow), recipe)
