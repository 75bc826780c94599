"""Settings of a map, changed inside one transaction: its ranking, what it keeps, blurs and refuses."""

from collections.abc import Callable
from typing import Any

import sqlalchemy as sa

from schemas.errors import Conflict, InvalidParameters
from schemas.map_changes import MapChanges
from schemas.recipe import MapRecipe, RankingConfig
from worker.storage import forgetting, switching
from worker.storage.day_scores import drop_scores
from worker.storage.kept_queries import drop_oldest
from worker.storage.rows import as_json, blur_of, find_map, find_recipe, has_views, map_record, ranking_of
from worker.storage.tables import MAPS


def change(connection: sa.Connection, name: str, changes: MapChanges) -> int | None:
    """Change a map; when one of the changes is refused, the transaction must be rolled back.

    Returns
    -------
    int or None
        The number of the map where the images of its described views are to be removed after the commit.

    Raises
    ------
    NotFound, Conflict
    """
    row = find_map(connection, name)
    if changes.ranking is not None:
        _set_ranking(connection, row, changes.ranking)
    if changes.blur is not None:
        _set_blur(connection, row, changes.blur)
    if changes.keep_queries is not None:
        _keep_queries(connection, row, changes.keep_queries, matched=False)
    if changes.keep_matches is not None:
        _keep_queries(connection, row, changes.keep_matches, matched=True)
    if changes.refuse_poor is not None:
        _update(connection, row, refuse_poor=changes.refuse_poor or None)
    if changes.keep_images is not None and forgetting.set_keep_images(connection, row, changes.keep_images):
        return int(row.id)
    return None


def _set_ranking(connection: sa.Connection, row: sa.Row[Any], change_of: Callable[[MapRecipe], RankingConfig]) -> None:
    recipe = map_record(connection, row).recipe
    ranking = change_of(recipe)
    if ranking != recipe.ranking:
        switching.set_ranking(connection, row, ranking.model_dump_json())
    if row.next_ranking is None:
        return
    # A recipe switch must not undo the change; but a shadow keeps the scores that it is compared by.
    following = MapRecipe(description=find_recipe(connection, row.next_recipe), ranking=ranking_of(row.next_ranking))
    if row.shadow is None:
        after = _changed_too(row, following, change_of)
    elif ranking.precision != recipe.ranking.precision:
        after = following.ranking.model_copy(update={"precision": ranking.precision})
    else:
        return
    _update(connection, row, next_ranking=after.model_dump_json())


def _changed_too(
    row: sa.Row[Any], following: MapRecipe, change_of: Callable[[MapRecipe], RankingConfig]
) -> RankingConfig:
    """The changed ranking for the recipe that a map changes over to; raises Conflict where that does not allow it."""
    try:
        return change_of(following)
    except InvalidParameters as error:
        raise Conflict(
            f"the map {row.name!r} is changing over to the recipe {following.description.id}, which does not allow "
            f"this ranking: {error.detail}; change it when GET /maps/{row.name} shows that recipe"
        ) from None


def _set_blur(connection: sa.Connection, row: sa.Row[Any], words: tuple[str, ...]) -> None:
    added = [word for word in words if word not in blur_of(row)]
    if added and has_views(connection, row.id):
        raise Conflict(
            f"the map {row.name!r} has views whose images were stored with {', '.join(added)} to be seen; blur "
            "them in a new map, before its first view, and enrol the images there"
        )
    stored = as_json(list(words)) if words else None
    if stored != row.blur:
        _update(connection, row, blur=stored)
    if added:
        drop_oldest(connection, row.id, 0, matched=None)  # kept queries show it too


def _keep_queries(connection: sa.Connection, row: sa.Row[Any], count: int, *, matched: bool) -> None:
    """Keep at most `count` queries of one kind. Scores of sure matches are kept as long as the matched ones are."""
    _update(connection, row, **{"keep_matches" if matched else "keep_queries": count or None})
    drop_oldest(connection, row.id, count, matched=matched)
    if matched and count == 0:
        drop_scores(connection, row.id)


def _update(connection: sa.Connection, row: sa.Row[Any], **values: Any) -> None:
    connection.execute(sa.update(MAPS).where(MAPS.c.id == row.id).values(**values))
