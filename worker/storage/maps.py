"""Maps: made, counted, given another recipe."""

from datetime import datetime

import sqlalchemy as sa

from schemas.errors import Conflict, NotFound
from schemas.recipe import Recipe
from schemas.records import MapCounts, MapRecord, Position, ViewState
from worker.storage import clock, switching
from worker.storage.part import Part
from worker.storage.rows import COORDINATES, find_map, find_recipe, keep_recipe, map_record
from worker.storage.tables import MAPS, RECIPES, VIEWS

STATES: tuple[ViewState, ...] = ("pending", "ready", "failed")


def make_map(connection: sa.Connection, name: str, recipe: Recipe, now: datetime) -> None:
    """Add an empty map, inside a transaction that is written in turn."""
    born = clock.read(connection)
    connection.execute(
        sa.insert(MAPS).values(
            name=name, recipe=keep_recipe(connection, recipe), revision=born, anew=born, created_at=now
        )
    )


class Maps(Part):
    """The promises of `schemas.ports.Store` about maps."""

    def maps(self) -> list[MapRecord]:
        """All maps, by name."""
        with self._database.reading() as connection:
            recipes = {
                row.id: Recipe.model_validate_json(row.body)
                for row in connection.execute(sa.select(RECIPES).where(RECIPES.c.id.in_(sa.select(MAPS.c.recipe))))
            }
            rows = connection.execute(sa.select(MAPS).where(MAPS.c.name.is_not(None)).order_by(MAPS.c.name))
            return [MapRecord(row.name, row.revision, recipes[row.recipe], row.created_at) for row in rows]

    def map(self, name: str) -> MapRecord:
        """One map; raises NotFound."""
        with self._database.reading() as connection:
            return map_record(connection, find_map(connection, name))

    def revision(self, name: str) -> int:
        """The map's revision; raises NotFound."""
        with self._database.reading() as connection:
            revision = connection.scalar(sa.select(MAPS.c.revision).where(MAPS.c.name == name))
        if revision is None:
            raise NotFound("map", name)
        return int(revision)

    def counts(self, name: str) -> MapCounts:
        """Size of a map; raises NotFound."""
        axes = COORDINATES[:-1]  # a box has no heading
        totals = sa.select(
            *(sa.func.count(sa.case((VIEWS.c.state == state, 1))).label(state) for state in STATES),
            sa.func.coalesce(sa.func.sum(VIEWS.c.byte_count), 0).label("picture_bytes"),
            *(sa.func.min(VIEWS.c[axis]).label(f"lowest_{axis}") for axis in axes),
            *(sa.func.max(VIEWS.c[axis]).label(f"highest_{axis}") for axis in axes),
        )
        # Apart from the rest: an index answers it without a look at the views.
        distinct = sa.select(sa.func.count(sa.distinct(VIEWS.c.place)))
        with self._database.reading() as connection:
            own = VIEWS.c.map_id == find_map(connection, name).id
            row = connection.execute(totals.where(own)).one()._mapping
            places = connection.execute(distinct.where(own)).scalar_one()
        return MapCounts(
            views={state: row[state] for state in STATES},
            places=places,
            image_bytes=int(row["picture_bytes"]),
            lowest=Position(**{axis: row[f"lowest_{axis}"] for axis in axes}),
            highest=Position(**{axis: row[f"highest_{axis}"] for axis in axes}),
        )

    def put_map(self, name: str, recipe: Recipe, now: datetime) -> tuple[MapRecord, bool]:
        """Make a map, or give an empty one another recipe; see `Store.put_map`."""
        with self._database.writing() as connection:
            row = connection.execute(sa.select(MAPS).where(MAPS.c.name == name)).one_or_none()
            if row is None:
                make_map(connection, name, recipe, now)
            elif row.recipe != recipe.id:
                if connection.scalar(sa.select(VIEWS.c.seq).where(VIEWS.c.map_id == row.id).limit(1)) is not None:
                    raise Conflict(
                        f"the map {name!r} has views that were described by the recipe {row.recipe}; "
                        f"POST /maps/{name}/recipe describes them anew"
                    )
                switching.change_over(connection, row.id, keep_recipe(connection, recipe))
            return map_record(connection, find_map(connection, name)), row is None

    def switch_recipe(self, name: str, recipe: Recipe, now: datetime) -> int:
        """Begin to re-describe a map's views; see `Store.switch_recipe`."""
        with self._database.writing() as connection:
            row = find_map(connection, name)
            if row.next_recipe is not None:
                target = find_recipe(connection, row.next_recipe)
                raise Conflict(
                    f"the map {name!r} is being described anew already, by the recipe {target.id} "
                    f"(preset {target.preset}); wait until that has finished"
                )
            return switching.begin(connection, row, keep_recipe(connection, recipe), now)
