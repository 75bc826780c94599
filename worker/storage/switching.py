"""Recipe switches: a map changes from one recipe to another without answers that mix the two.

While ``maps.next_recipe`` is set, each view gets a description by it beside the one in use. When no job for it is left,
the map changes over to it, in the transaction that settled the last job. While ``maps.shadow`` is set too, it does not:
the job of that id then waits for a worker that compares the answers by both, and the map changes over when it is told.
"""

import hashlib
import json
from collections.abc import Collection, Mapping
from datetime import datetime
from typing import Any

import sqlalchemy as sa
from uuid6 import uuid7

from schemas.errors import Conflict, PoorImage
from schemas.recipe import MapRecipe, RankingConfig
from schemas.records import Failure
from worker.storage import clock
from worker.storage.image_store import forgets
from worker.storage.rows import as_json, batches, inserting, ranking_of
from worker.storage.tables import COMPARISONS, DESCRIPTIONS, JOBS, MAPS, VIEWS

UNFINISHED = ("waiting", "running")

NOTHING_NEXT: Mapping[str, None] = {"next_recipe": None, "next_ranking": None, "shadow": None}
"""Columns of a map that is not being changed."""

DISCARDED = "the map keeps the recipe that it has"

GIVEN_ANOTHER = "the map was empty and was given another recipe"

CHANGED_OVER = "the map has another recipe by now, by which the view is described"

NO_IMAGES = (
    "the map {!r} keeps no images, so that its views can neither be described anew nor learned from; enrol the images "
    "in a map that has the recipe from the start"
)


_UNFINISHED_JOB = sa.select(JOBS.c.id).where(
    JOBS.c.seq == sa.bindparam("of"), JOBS.c.recipe == sa.bindparam("by"), JOBS.c.state.in_(UNFINISHED)
)
# No row for most maps. By the recipe that the map is changing to, or has: a map has a finished job for each view.
_CHANGING = (
    sa.select(MAPS.c.recipe, MAPS.c.next_recipe, MAPS.c.next_ranking, MAPS.c.shadow, JOBS.c.number)
    .outerjoin(
        JOBS,
        (JOBS.c.map_id == MAPS.c.id)
        & (JOBS.c.kind != "describe")
        & (JOBS.c.state == "running")
        & (JOBS.c.recipe == sa.func.coalesce(MAPS.c.next_recipe, MAPS.c.recipe)),
    )
    .where(MAPS.c.id == sa.bindparam("of"), JOBS.c.number.is_not(None) | MAPS.c.next_recipe.is_not(None))
)


_REFUSED = (VIEWS.c.state == "failed") & (sa.func.coalesce(VIEWS.c.failure_code, "") == PoorImage.code)


def queue(
    connection: sa.Connection,
    map_id: int,
    seqs: list[int],
    recipe: str,
    now: datetime,
    *,
    background: bool,
    refuse_poor: bool = False,
) -> list[str]:
    """Queue the description of views by a recipe; returns the jobs' ids.

    `refuse_poor`: views whose descriptions show that their images are poor are to fail.
    """
    every = {
        "kind": "describe",
        "map_id": map_id,
        "recipe": recipe,
        "background": background,
        "state": "waiting",
        "attempts": 0,
        "created_at": now,
        "refuse_poor": refuse_poor or None,
    }
    ids: list[str] = []
    for portion in batches(seqs):
        rows = [{**every, "id": str(uuid7()), "seq": seq} for seq in portion]
        connection.execute(inserting(JOBS), rows)
        ids += [str(row["id"]) for row in rows]
    return ids


def unfinished_job(connection: sa.Connection, seq: int, recipe: str) -> str | None:
    """Id of the unfinished job that describes a view by a recipe, or None."""
    job: str | None = connection.scalar(_UNFINISHED_JOB, {"of": seq, "by": recipe})
    return job


def is_described(recipe: str) -> sa.ColumnElement[bool]:
    """SQL condition that a view has a description by a recipe."""
    return sa.exists().where(DESCRIPTIONS.c.seq == VIEWS.c.seq, DESCRIPTIONS.c.recipe == recipe)


def begin(
    connection: sa.Connection,
    row: sa.Row[Any],
    recipe: str,
    ranking: str,
    job: str | None,
    now: datetime,
    *,
    shadow: bool = False,
) -> int:
    """Begin a recipe switch; returns how many views must be described first; raises Conflict if images are gone.

    Parameters
    ----------
    row
        Row of the map.
    recipe : str
        Id of a stored description recipe.
    ranking : str
        JSON of the ranking config used from the change on.
    job : str or None
        Id of the job of the map that runs until the change; None queues one of the kind ``recipe``.
    shadow : bool
        The map changes over only when it is told; the recipe is another than the map's.
    """
    if job is None:
        job = str(uuid7())
        new = {"id": job, "kind": "recipe", "map_id": row.id, "recipe": recipe, "background": True}
        connection.execute(inserting(JOBS), {**new, "state": "running", "attempts": 1, "created_at": now})
    under_way = sa.exists().where(JOBS.c.seq == VIEWS.c.seq, JOBS.c.recipe == recipe, JOBS.c.state.in_(UNFINISHED))
    lacking = [VIEWS.c.map_id == row.id, ~is_described(recipe), ~under_way, ~_REFUSED]
    seqs = list(connection.scalars(sa.select(VIEWS.c.seq).where(*lacking).order_by(VIEWS.c.seq)))
    refuse_without_images(connection, row, seqs)
    queue(connection, row.id, seqs, recipe, now, background=True)
    if recipe == row.recipe:  # the recipe stays: only failed views are described again
        set_states(connection, row.id, recipe)
        if ranking != row.ranking:
            set_ranking(connection, row, ranking)
    else:
        if not _score_alike(ranking, row.ranking):  # made when the map had this recipe, or a shadow of it
            _drop_comparisons(connection, row.id, COMPARISONS.c.recipe == recipe)
        following = {"next_recipe": recipe, "next_ranking": ranking, "shadow": job if shadow else None}
        connection.execute(sa.update(MAPS).where(MAPS.c.id == row.id).values(**following))
    finish_if_done(connection, row.id, now)
    return len(seqs)


def refuse_without_images(connection: sa.Connection, row: sa.Row[Any], seqs: list[int] | None = None) -> None:
    """Raise Conflict when the images of views of a map, or of those in `seqs`, are no longer kept."""
    if not forgets(connection, row.id):
        return
    gone = sa.select(VIEWS.c.seq).where(VIEWS.c.map_id == row.id, VIEWS.c.state == "ready").limit(1)
    some = [gone] if seqs is None else [gone.where(VIEWS.c.seq.in_(portion)) for portion in batches(seqs)]
    if any(connection.scalar(one) is not None for one in some):
        raise Conflict(NO_IMAGES.format(row.name))


def refuse_with_shadow(row: sa.Row[Any]) -> None:
    """Raise Conflict when a map has a shadow; of its row."""
    if row.shadow is not None:
        raise Conflict(
            f"the map {row.name!r} has a shadow, by the job {row.shadow}: POST /maps/{row.name}/shadow/switch changes "
            f"over to it, DELETE /maps/{row.name}/shadow discards it"
        )


def set_ranking(connection: sa.Connection, row: sa.Row[Any], ranking: str) -> None:
    """Replace a map's ranking; a new revision, since it changes answers.

    What was learned from scores, its comparisons and its own calibration, is dropped when these change.
    """
    connection.execute(sa.update(MAPS).where(MAPS.c.id == row.id).values(ranking=ranking))
    if not _score_alike(ranking, row.ranking):
        connection.execute(sa.update(MAPS).where(MAPS.c.id == row.id).values(calibration=None))
        _drop_comparisons(connection, row.id)
    clock.tick(connection, row.id)


def _drop_comparisons(connection: sa.Connection, map_id: int, *which: sa.ColumnElement[bool]) -> None:
    """Drop comparisons of a map's views, all of them or some.

    Those that are kept were made by the ranking that the map has, those by the recipe of its shadow by the ranking of
    that: whoever goes back to a recipe finds no other scores there.
    """
    connection.execute(sa.delete(COMPARISONS).where(COMPARISONS.c.map_id == map_id, *which))


def _score_alike(one: str, other: str) -> bool:
    """Whether two rankings, as JSON, give the same scores."""
    return _scoring(ranking_of(one)) == _scoring(ranking_of(other))


def scores_alike(one: MapRecipe, other: MapRecipe) -> bool:
    """Whether two recipes give the same scores."""
    return one.description == other.description and _scoring(one.ranking) == _scoring(other.ranking)


def scoring_basis(recipe: MapRecipe) -> str:
    """Digest of what scores depend on: equal where `scores_alike`."""
    scoring = f"{recipe.description.id} {_scoring(recipe.ranking).model_dump_json()}"
    return hashlib.sha256(scoring.encode()).hexdigest()[:16]


def _scoring(ranking: RankingConfig) -> RankingConfig:
    """The part of a ranking that scores depend on."""
    return ranking.model_copy(update={"precision": 0.5})


def finish_if_done(connection: sa.Connection, map_id: int, now: datetime) -> int | None:
    """End a recipe switch when no view is left to describe; returns the map's revision if it ended."""
    row = connection.execute(_CHANGING, {"of": map_id}).one_or_none()
    if row is None:
        return None
    if row.next_recipe is None:  # failed views are described again by the same recipe
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
    if row.shadow is not None:  # described: a worker compares the answers, unless that has begun
        described_all = JOBS.c.id == row.shadow, JOBS.c.state == "running", JOBS.c.token.is_(None)
        connection.execute(sa.update(JOBS).where(*described_all).values(state="waiting"))
        return None
    return change_over(connection, map_id, row.next_recipe, row.next_ranking, now)


def change_over(connection: sa.Connection, map_id: int, recipe: str, ranking: str, now: datetime) -> int:
    """Set a map's recipe and ranking, after its views were described; returns the new revision."""
    revision = clock.tick(connection, map_id)
    row = connection.execute(sa.select(MAPS).where(MAPS.c.id == map_id)).one()
    if row.shadow is not None:  # of an empty map that was given another recipe at once
        end_shadow(connection, map_id, now)
        drop_rows(connection, row.shadow)
    if not _score_alike(ranking, row.ranking):
        _drop_comparisons(connection, map_id, COMPARISONS.c.recipe != recipe)
    after = {"recipe": recipe, "ranking": ranking, "anew": revision, **NOTHING_NEXT}
    learned = {"calibration": None, "previous_recipe": row.recipe}  # what was learned by the old recipe is dropped
    connection.execute(sa.update(MAPS).where(MAPS.c.id == map_id).values(**learned, **after))
    set_states(connection, map_id, recipe)
    end_jobs(connection, map_id, recipe, now)
    # Those by the recipe before that nobody has begun: their encoder may no longer be there.
    before = (JOBS.c.kind == "describe") & (JOBS.c.recipe != recipe) & (JOBS.c.state == "waiting")
    _cancel(connection, map_id, before, now, CHANGED_OVER)
    return revision


def end_jobs(connection: sa.Connection, map_id: int, recipe: str, now: datetime) -> None:
    """End the jobs of a map that switch it to a recipe."""
    own = JOBS.c.map_id == map_id, JOBS.c.kind != "describe", JOBS.c.recipe == recipe, JOBS.c.state == "running"
    for number in list(connection.scalars(sa.select(JOBS.c.number).where(*own))):
        done, total = count_jobs(connection, map_id, recipe, number)
        connection.execute(
            sa.update(JOBS)
            .where(JOBS.c.number == number)
            .values(state="done", finished_at=now, token=None, result=as_json({"recipe": recipe}))
            .values(progress_done=done, progress_total=total)
        )


def count_jobs(connection: sa.Connection, map_id: int, recipe: str, since: int) -> tuple[int, int]:
    """How many describe jobs of a map by a recipe were queued after job number `since`: those that ended, and all."""
    queued = sa.select(sa.func.count(sa.case((JOBS.c.state.not_in(UNFINISHED), 1))), sa.func.count()).where(
        JOBS.c.map_id == map_id, JOBS.c.kind == "describe", JOBS.c.recipe == recipe, JOBS.c.number > since
    )
    done, total = connection.execute(queued).one()
    return int(done), int(total)


def stop(connection: sa.Connection, map_id: int, recipe: str, now: datetime) -> None:
    """Stop a recipe switch: cancel its describe jobs; the map keeps its recipe."""
    connection.execute(
        sa.update(JOBS)
        .where(JOBS.c.map_id == map_id, JOBS.c.kind == "describe", JOBS.c.recipe == recipe)
        .where(JOBS.c.state.in_(UNFINISHED))
        .values(state="cancelled", finished_at=now, token=None)
    )
    row = connection.execute(sa.select(MAPS).where(MAPS.c.id == map_id)).one()
    if row.next_ranking is not None and not _score_alike(row.next_ranking, row.ranking):
        _drop_comparisons(connection, map_id, COMPARISONS.c.recipe == recipe)
    connection.execute(sa.update(MAPS).where(MAPS.c.id == map_id).values(**NOTHING_NEXT))


def stop_trying_again(connection: sa.Connection, job: sa.Row[Any], now: datetime, failure: Failure) -> None:
    """Stop the job that has failed views described again by the map's own recipe: those that wait are failed again.

    Of what waits by this recipe only the views that the job queued are its own; the others were enrolled.
    """
    queued = JOBS.c.kind == "describe", JOBS.c.background, JOBS.c.created_at == job.created_at
    mine = JOBS.c.map_id == job.map_id, JOBS.c.recipe == job.recipe, JOBS.c.number > job.number
    ended = {"state": "cancelled", "finished_at": now, "token": None}
    reason = {"failure_code": failure.code, "failure_detail": failure.detail}
    own = sa.update(JOBS).where(*queued, *mine, JOBS.c.state.in_(UNFINISHED))
    connection.execute(own.values(**ended, **reason))
    set_states(connection, job.map_id, job.recipe)


def end_shadow(connection: sa.Connection, map_id: int, now: datetime) -> None:
    """Cancel the job of a map's shadow, if it has not ended."""
    _cancel(connection, map_id, JOBS.c.kind == "shadow", now, DISCARDED)


def end_training(connection: sa.Connection, map_id: int, now: datetime) -> None:
    """Cancel the training of a vocabulary for a recipe that an empty map no longer has, if it has not ended."""
    training = (JOBS.c.kind == "vocabulary") & JOBS.c.recipe.is_(None)
    _cancel(connection, map_id, training, now, GIVEN_ANOTHER)


def _cancel(connection: sa.Connection, map_id: int, which: sa.ColumnElement[bool], now: datetime, why: str) -> None:
    unfinished = JOBS.c.map_id == map_id, which, JOBS.c.state.in_(UNFINISHED)
    reason = {"failure_code": "cancelled", "failure_detail": why}
    ended = {"state": "cancelled", "finished_at": now, "token": None}
    connection.execute(sa.update(JOBS).where(*unfinished).values(**ended, **reason))


def drop_rows(connection: sa.Connection, job: str, views: Collection[str] | None = None) -> None:
    """Drop the rows of a shadow's table: those that name a view of `views`, which are deleted; None: all of them.

    Its totals stay.
    """
    result = connection.scalar(sa.select(JOBS.c.result).where(JOBS.c.id == job))
    table = {} if result is None else json.loads(result)
    if table.get("queries"):
        kept = [] if views is None else [row for row in table["queries"] if views_of_row(row).isdisjoint(views)]
        if len(kept) < len(table["queries"]):
            values = {"result": as_json({**table, "queries": kept})}
            connection.execute(sa.update(JOBS).where(JOBS.c.id == job).values(**values))


def views_of_row(row: Mapping[str, Any]) -> set[str]:
    """Ids of the views that a row of a shadow's table names."""
    own = row["id"] if row.get("source") == "view" else None  # else it is that of a kept query
    return {view for view in (own, row["old"]["view"], row["new"]["view"]) if view is not None}


def set_states(connection: sa.Connection, map_id: int, recipe: str) -> None:
    """Set the state of each view of a map by a recipe: ready, pending, or failed with the reason of its last job.

    One that was refused as poor stays so until its image is sent again.
    """
    own = sa.update(VIEWS).where(VIEWS.c.map_id == map_id)
    # Those alone that change: PostgreSQL writes each row anew, with an entry in every index, while others wait.
    was_otherwise = (VIEWS.c.state != "ready") | VIEWS.c.failure_code.is_not(None)
    connection.execute(
        own.where(is_described(recipe), ~_REFUSED, was_otherwise).values(
            state="ready", failure_code=None, failure_detail=None
        )
    )
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
        own.where(~is_described(recipe), ~_REFUSED).values(
            state=sa.case((of_last(jobs.c.state).in_(UNFINISHED), "pending"), else_="failed"),
            failure_code=of_last(jobs.c.failure_code),
            failure_detail=of_last(jobs.c.failure_detail),
        )
    )


def needs_no_job(connection: sa.Connection, seq: int, recipe: str) -> bool:
    """Whether a view has a description by a recipe, or an unfinished job for one."""
    described = sa.select(DESCRIPTIONS.c.seq).where(DESCRIPTIONS.c.seq == seq, DESCRIPTIONS.c.recipe == recipe)
    return connection.execute(described).first() is not None or unfinished_job(connection, seq, recipe) is not None
