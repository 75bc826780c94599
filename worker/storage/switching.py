"""From one recipe of a map to another, without a moment in which answers mix the two.

While ``maps.next_recipe`` is set, each view gets a description by it beside the one in use. When no job for it is left
the map changes over, in the transaction that settled the last one.
"""

from datetime import datetime
from typing import Any

import sqlalchemy as sa
from uuid6 import uuid7

from worker.storage import clock
from worker.storage.rows import as_json, inserting
from worker.storage.tables import DESCRIPTIONS, JOBS, MAPS, VIEWS

UNFINISHED = ("waiting", "running")


_UNFINISHED_JOB = sa.select(JOBS.c.id).where(
    JOBS.c.seq == sa.bindparam("of"), JOBS.c.recipe == sa.bindparam("by"), JOBS.c.state.in_(UNFINISHED)
)
_CHANGING = (  # most maps are not: one look tells
    sa.select(MAPS.c.recipe, MAPS.c.next_recipe, MAPS.c.next_ranking, JOBS.c.number)
    .join(JOBS, (JOBS.c.map_id == MAPS.c.id) & (JOBS.c.kind != "describe") & (JOBS.c.state == "running"))
    .where(MAPS.c.id == sa.bindparam("of"), JOBS.c.recipe.is_not(None))
)


def queue(
    connection: sa.Connection, map_id: int, seqs: list[int], recipe: str, now: datetime, *, background: bool
) -> list[str]:
    """Queue the description of views by a recipe; returns the jobs' ids."""
    rows = [
        {
            "id": str(uuid7()),
            "kind": "describe",
            "map_id": map_id,
            "seq": seq,
            "recipe": recipe,
            "background": background,
            "state": "waiting",
            "attempts": 0,
            "created_at": now,
        }
        for seq in seqs
    ]
    if rows:
        connection.execute(inserting(JOBS), rows)
    return [str(row["id"]) for row in rows]


def unfinished_job(connection: sa.Connection, seq: int, recipe: str) -> str | None:
    """Id of the job that is to describe a view by a recipe, if there is one."""
    job: str | None = connection.scalar(_UNFINISHED_JOB, {"of": seq, "by": recipe})
    return job


def is_described(recipe: str) -> sa.ColumnElement[bool]:
    """Whether a view has a description by a recipe."""
    return sa.exists().where(DESCRIPTIONS.c.seq == VIEWS.c.seq, DESCRIPTIONS.c.recipe == recipe)


def begin(
    connection: sa.Connection, row: sa.Row[Any], recipe: str, ranking: str, job: str | None, now: datetime
) -> int:
    """Begin to change a map over; returns how many views must be described first.

    Parameters
    ----------
    row
        Of the map.
    recipe : str
        Id of a kept description recipe.
    ranking : str
        JSON of the ranking that begins with it.
    job : str or None
        Id of the job of the map that goes on until the change; None makes one of the kind ``recipe``.
    """
    if job is None:
        job = str(uuid7())
        new = {"id": job, "kind": "recipe", "map_id": row.id, "recipe": recipe, "background": True}
        connection.execute(inserting(JOBS), {**new, "state": "running", "attempts": 1, "created_at": now})
    under_way = sa.exists().where(JOBS.c.seq == VIEWS.c.seq, JOBS.c.recipe == recipe, JOBS.c.state.in_(UNFINISHED))
    lacking = [VIEWS.c.map_id == row.id, ~is_described(recipe), ~under_way]
    seqs = list(connection.scalars(sa.select(VIEWS.c.seq).where(*lacking).order_by(VIEWS.c.seq)))
    queue(connection, row.id, seqs, recipe, now, background=True)
    if recipe == row.recipe:  # nothing to change over to: only what failed is tried again
        settle(connection, row.id, recipe)
        if ranking != row.ranking:
            set_ranking(connection, row.id, ranking)
    else:
        following = {"next_recipe": recipe, "next_ranking": ranking}
        connection.execute(sa.update(MAPS).where(MAPS.c.id == row.id).values(**following))
    finish_if_done(connection, row.id, now)
    return len(seqs)


def set_ranking(connection: sa.Connection, map_id: int, ranking: str) -> None:
    """Give a map another ranking: queries notice, so it is a revision."""
    connection.execute(sa.update(MAPS).where(MAPS.c.id == map_id).values(ranking=ranking))
    clock.tick(connection, map_id)


def finish_if_done(connection: sa.Connection, map_id: int, now: datetime) -> int | None:
    """Change a map over when no view is left to be described; returns the revision if that happened."""
    row = connection.execute(_CHANGING, {"of": map_id}).one_or_none()
    if row is None:
        return None
    if row.next_recipe is None:  # views that had failed are tried again by the recipe that the map has
        again = sa.select(JOBS.c.number).where(
            JOBS.c.map_id == map_id, JOBS.c.kind == "describe", JOBS.c.recipe == row.recipe, JOBS.c.background,
            JOBS.c.number > row.number, JOBS.c.state.in_(UNFINISHED),
        )  # fmt: skip
        if connection.execute(again.limit(1)).first() is None:
            end_jobs(connection, map_id, row.recipe, now)
        return None
    left = sa.select(JOBS.c.number).where(
        JOBS.c.map_id == map_id, JOBS.c.kind == "describe", JOBS.c.recipe == row.next_recipe,
        JOBS.c.state.in_(UNFINISHED),
    )  # fmt: skip
    if connection.execute(left.limit(1)).first() is not None:
        return None
    return change_over(connection, map_id, row.next_recipe, row.next_ranking, now)


def change_over(connection: sa.Connection, map_id: int, recipe: str, ranking: str, now: datetime) -> int:
    """Give a map the recipe whose descriptions are there; returns the map's new revision."""
    revision = clock.tick(connection, map_id)
    present = connection.scalar(sa.select(MAPS.c.recipe).where(MAPS.c.id == map_id))
    after = {"recipe": recipe, "ranking": ranking, "next_recipe": None, "next_ranking": None, "anew": revision}
    connection.execute(sa.update(MAPS).where(MAPS.c.id == map_id).values(previous_recipe=present, **after))
    settle(connection, map_id, recipe)
    end_jobs(connection, map_id, recipe, now)
    return revision


def end_jobs(connection: sa.Connection, map_id: int, recipe: str, now: datetime) -> None:
    """End the jobs of a map that were to bring it to a recipe."""
    own = JOBS.c.map_id == map_id, JOBS.c.kind != "describe", JOBS.c.recipe == recipe, JOBS.c.state == "running"
    for number in list(connection.scalars(sa.select(JOBS.c.number).where(*own))):
        done, total = described(connection, map_id, recipe, number)
        connection.execute(
            sa.update(JOBS)
            .where(JOBS.c.number == number)
            .values(state="done", finished_at=now, token=None, lease_until=None, result=as_json({"recipe": recipe}))
            .values(progress_done=done, progress_total=total)
        )


def described(connection: sa.Connection, map_id: int, recipe: str, since: int) -> tuple[int, int]:
    """How many of the views that were queued for a recipe after a job are settled, and how many there are."""
    queued = sa.select(sa.func.count(sa.case((JOBS.c.state.not_in(UNFINISHED), 1))), sa.func.count()).where(
        JOBS.c.map_id == map_id, JOBS.c.kind == "describe", JOBS.c.recipe == recipe, JOBS.c.number > since
    )
    done, total = connection.execute(queued).one()
    return int(done), int(total)


def stop(connection: sa.Connection, map_id: int, recipe: str, now: datetime) -> None:
    """Let a map keep its recipe: nothing more is described by the one it was to get."""
    connection.execute(
        sa.update(JOBS)
        .where(JOBS.c.map_id == map_id, JOBS.c.kind == "describe", JOBS.c.recipe == recipe)
        .where(JOBS.c.state.in_(UNFINISHED))
        .values(state="cancelled", finished_at=now, token=None, lease_until=None)
    )
    connection.execute(sa.update(MAPS).where(MAPS.c.id == map_id).values(next_recipe=None, next_ranking=None))


def settle(connection: sa.Connection, map_id: int, recipe: str) -> None:
    """Give each view of a map the state that it has under a recipe: ready, pending, or failed as its last job did."""
    own = sa.update(VIEWS).where(VIEWS.c.map_id == map_id)
    connection.execute(own.where(is_described(recipe)).values(state="ready", failure_code=None, failure_detail=None))
    last = (
        sa.select(sa.func.max(JOBS.c.number))
        .where(JOBS.c.seq == VIEWS.c.seq, JOBS.c.recipe == recipe)
        .correlate(VIEWS)
        .scalar_subquery()
    )
    jobs = JOBS.alias()

    def of_last(column: sa.Column[Any]) -> sa.ScalarSelect[Any]:
        return sa.select(column).where(jobs.c.number == last).correlate(VIEWS).scalar_subquery()

    connection.execute(
        own.where(~is_described(recipe)).values(
            state=sa.case((of_last(jobs.c.state).in_(UNFINISHED), "pending"), else_="failed"),
            failure_code=of_last(jobs.c.failure_code),
            failure_detail=of_last(jobs.c.failure_detail),
        )
    )


def settled(connection: sa.Connection, seq: int, recipe: str) -> bool:
    """Whether a view has a description by a recipe, or a job for it."""
    described = sa.select(DESCRIPTIONS.c.seq).where(DESCRIPTIONS.c.seq == seq, DESCRIPTIONS.c.recipe == recipe)
    return connection.execute(described).first() is not None or unfinished_job(connection, seq, recipe) is not None
