"""Removes descriptions, recipes and vocabularies that no map uses, a portion at a time."""

import sqlalchemy as sa

from worker.storage.part import Part
from worker.storage.tables import DESCRIPTIONS, JOBS, MAPS, RECIPES, VOCABULARIES

PORTION = 200
"""Descriptions removed in one transaction; more would keep other writers waiting."""

_STALE = (  # by the recipes, which are few, not by the descriptions
    sa.select(MAPS.c.id, RECIPES.c.id.label("recipe"))
    .join(RECIPES, sa.true())
    .where(
        RECIPES.c.id != MAPS.c.recipe,
        sa.or_(MAPS.c.next_recipe.is_(None), RECIPES.c.id != MAPS.c.next_recipe),
        sa.or_(MAPS.c.previous_recipe.is_(None), RECIPES.c.id != MAPS.c.previous_recipe),
        sa.exists().where(DESCRIPTIONS.c.map_id == MAPS.c.id, DESCRIPTIONS.c.recipe == RECIPES.c.id),
    )
    .limit(1)
)

_OF_MAPS = sa.union(
    sa.select(MAPS.c.recipe),
    sa.select(MAPS.c.next_recipe).where(MAPS.c.next_recipe.is_not(None)),
    sa.select(MAPS.c.previous_recipe).where(MAPS.c.previous_recipe.is_not(None)),
)
_USED = [  # by the maps, which are few, one after another: else SQLite reads all descriptions and jobs
    sa.exists(
        sa.select(MAPS.c.id)
        .where(sa.exists().where(of.c.map_id == MAPS.c.id, of.c.recipe == RECIPES.c.id).correlate(MAPS, RECIPES))
        .correlate(RECIPES)
    )
    for of in (DESCRIPTIONS, JOBS)
]
_UNUSED = (  # as when the map was deleted that had it
    sa.select(RECIPES.c.id).where(RECIPES.c.id.not_in(_OF_MAPS), *(~used for used in _USED)).limit(1)
)


class Pruning(Part):
    """Removes what recipe switches and deleted maps leave. A map keeps descriptions by its present, next and previous
    recipe."""

    def prune(self) -> int:
        """Remove one portion of unused descriptions, or what no map uses of recipes and vocabularies; returns how many
        descriptions, 0 when none is left."""
        with self._database.reading() as connection:
            if connection.execute(_STALE).first() is None and connection.execute(_UNUSED).first() is None:
                return 0
        with self._database.writing(frees=True) as connection:
            stale = connection.execute(_STALE).one_or_none()
            if stale is None:
                self._forget_recipes(connection)
                return 0
            of = DESCRIPTIONS.c.map_id == stale.id, DESCRIPTIONS.c.recipe == stale.recipe
            seqs = list(connection.scalars(sa.select(DESCRIPTIONS.c.seq).where(*of).limit(PORTION)))
            connection.execute(sa.delete(DESCRIPTIONS).where(*of, DESCRIPTIONS.c.seq.in_(seqs)))
            if len(seqs) < PORTION:
                self._forget_recipes(connection)
            return len(seqs)

    @staticmethod
    def _forget_recipes(connection: sa.Connection) -> None:
        """Delete recipes without map, description or job, and vocabularies without recipe."""
        used = sa.union(
            _OF_MAPS.subquery().select(),
            sa.select(DESCRIPTIONS.c.recipe),
            sa.select(JOBS.c.recipe).where(JOBS.c.recipe.is_not(None)),
        )
        connection.execute(sa.delete(RECIPES).where(RECIPES.c.id.not_in(used)))
        named = sa.exists().where(RECIPES.c.body.contains(VOCABULARIES.c.digest))
        connection.execute(sa.delete(VOCABULARIES).where(~named))
