"""Removes descriptions, recipes and vocabularies that no map uses, a portion at a time."""

import sqlalchemy as sa

from worker.storage.part import Part
from worker.storage.tables import DESCRIPTIONS, JOBS, MAPS, RECIPES, VIEWS, VOCABULARIES

PORTION = 200
"""Descriptions removed in one transaction; more would keep other writers waiting."""

_STALE = (
    sa.select(DESCRIPTIONS.c.seq, DESCRIPTIONS.c.recipe)
    .join(VIEWS, VIEWS.c.seq == DESCRIPTIONS.c.seq)
    .join(MAPS, MAPS.c.id == VIEWS.c.map_id)
    .where(
        DESCRIPTIONS.c.recipe != MAPS.c.recipe,
        sa.or_(MAPS.c.next_recipe.is_(None), DESCRIPTIONS.c.recipe != MAPS.c.next_recipe),
        sa.or_(MAPS.c.previous_recipe.is_(None), DESCRIPTIONS.c.recipe != MAPS.c.previous_recipe),
    )
)


class Pruning(Part):
    """Removes what recipe switches leave. A map keeps descriptions by its present, next and previous recipe."""

    def prune(self) -> int:
        """Remove one portion of unused descriptions; returns how many, 0 when none is left."""
        with self._database.reading() as connection:
            if connection.execute(_STALE.limit(1)).first() is None:
                return 0
        with self._database.writing() as connection:
            stale = connection.execute(_STALE.limit(PORTION)).all()
            for recipe in {row.recipe for row in stale}:
                seqs = [row.seq for row in stale if row.recipe == recipe]
                connection.execute(
                    sa.delete(DESCRIPTIONS).where(DESCRIPTIONS.c.recipe == recipe, DESCRIPTIONS.c.seq.in_(seqs))
                )
            if len(stale) < PORTION:
                self._forget_recipes(connection)
            return len(stale)

    @staticmethod
    def _forget_recipes(connection: sa.Connection) -> None:
        """Delete recipes without map, description or job, and vocabularies without recipe."""
        used = sa.union(
            sa.select(MAPS.c.recipe),
            sa.select(MAPS.c.next_recipe).where(MAPS.c.next_recipe.is_not(None)),
            sa.select(MAPS.c.previous_recipe).where(MAPS.c.previous_recipe.is_not(None)),
            sa.select(DESCRIPTIONS.c.recipe),
            sa.select(JOBS.c.recipe).where(JOBS.c.recipe.is_not(None)),
        )
        connection.execute(sa.delete(RECIPES).where(RECIPES.c.id.not_in(used)))
        named = sa.exists().where(RECIPES.c.body.contains(VOCABULARIES.c.digest))
        connection.execute(sa.delete(VOCABULARIES).where(~named))
