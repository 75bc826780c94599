"""Maps: created, counted, given another recipe."""

from datetime import datetime
from typing import Any

import sqlalchemy as sa

from schemas.errors import Conflict, Damaged, NotFound
from schemas.map_changes import MapChanges
from schemas.recipe import DescriptionRecipe, MapRecipe
from schemas.records import MapCounts, MapRecord, Position, ViewState
from worker.storage import clock, forgetting, map_settings, switching
from worker.storage.image_store import needs_image
from worker.storage.part import Part
from worker.storage.rows import (
    COORDINATES,
    NO_MAP,
    blur_of,
    find_map,
    find_recipe,
    has_views,
    keep_recipe,
    log,
    map_by,
    map_record,
    recipe_of,
)
from worker.storage.tables import MAPS, RECIPES, VIEWS

STATES: tuple[ViewState, ...] = ("pending", "ready", "failed")


_AXES = COORDINATES[:-1]
"""A box has no heading."""

# Counted by itself: an index answers it without reading views.
_PLACES = sa.func.count(sa.distinct(VIEWS.c.place))


def _totals(connection: sa.Connection) -> list[sa.Label[Any]]:
    """Columns that sum views up, for `_counts_of`."""
    sound = sa.func.coalesce(VIEWS.c.failure_code, "") != Damaged.code
    kept = sa.case((needs_image(connection), VIEWS.c.byte_count))
    return [
        *(sa.func.count(sa.case((VIEWS.c.state == state, 1))).label(state) for state in STATES),
        sa.func.coalesce(sa.func.sum(kept), 0).label("picture_bytes"),
        *(sa.func.min(sa.case((sound, VIEWS.c[axis]))).label(f"lowest_{axis}") for axis in _AXES),
        *(sa.func.max(sa.case((sound, VIEWS.c[axis]))).label(f"highest_{axis}") for axis in _AXES),
        sa.func.min(sa.case((sa.and_(sound, VIEWS.c.lon >= 0), VIEWS.c.lon))).label("lowest_east"),
        sa.func.max(sa.case((sa.and_(sound, VIEWS.c.lon < 0), VIEWS.c.lon))).label("highest_west"),
    ]


def _counts_of(totals: sa.Row[Any], places: int) -> MapCounts:
    row = totals._mapping
    lowest = {axis: row[f"lowest_{axis}"] for axis in _AXES}
    highest = {axis: row[f"highest_{axis}"] for axis in _AXES}
    east, west = row["lowest_east"], row["highest_west"]
    if None not in (east, west) and west + 360 - east < highest["lon"] - lowest["lon"]:
        lowest["lon"], highest["lon"] = east, west  # the box over the meridian of 180 degrees is the narrower one
    return MapCounts(
        views={state: row[state] for state in STATES},
        places=places,
        image_bytes=int(row["picture_bytes"]),
        lowest=Position(**lowest),
        highest=Position(**highest),
    )


def make_map(connection: sa.Connection, name: str, recipe: MapRecipe, now: datetime) -> None:
    """Add an empty map, inside a transaction that writes in turn."""
    born = clock.read(connection)
    connection.execute(
        sa.insert(MAPS).values(
            name=name,
            recipe=keep_recipe(connection, recipe.description),
            ranking=recipe.ranking.model_dump_json(),
            revision=born,
            anew=born,
            created_at=now,
        )
    )


def find_or_make_map(connection: sa.Connection, name: str, recipe: MapRecipe | None, now: datetime) -> sa.Row[Any]:
    """The row of a map; one that is not there is made by `recipe`, or NotFound is raised where that is None."""
    try:
        return find_map(connection, name)
    except NotFound:
        if recipe is None:
            raise
    make_map(connection, name, recipe, now)
    return find_map(connection, name)


class Maps(Part):
    """Maps by name."""

    def all(self) -> list[MapRecord]:
        """All maps, sorted by name."""
        with self._database.reading() as connection:
            bodies = {row.id: row.body for row in connection.execute(sa.select(RECIPES))}
            rows = list(connection.execute(sa.select(MAPS).where(MAPS.c.name.is_not(None)).order_by(MAPS.c.name)))
        records = []
        for row in rows:
            try:
                records.append(map_by(recipe_of(row.recipe, str(bodies.get(row.recipe))), row))
            except Damaged as error:
                log.error("map %s is left out of the list: %s", row.name, error.detail)
        return records

    def numbers(self) -> set[int]:
        """The numbers of all maps, of which a deleted one's is given to no other."""
        with self._database.reading() as connection:
            return set(connection.scalars(sa.select(MAPS.c.id).where(MAPS.c.name.is_not(None))))

    def get(self, name: str) -> MapRecord:
        """One map; raises NotFound."""
        with self._database.reading() as connection:
            return map_record(connection, find_map(connection, name))

    def description(self, recipe: str) -> DescriptionRecipe:
        """A description recipe by its id; raises Damaged, also when no map or view uses it any more."""
        with self._database.reading() as connection:
            return find_recipe(connection, recipe)

    def labels(self, recipe: str) -> tuple[str, ...]:
        """Labels of a recipe, to which the shares of its descriptions refer; empty once no map or view uses it."""
        with self._database.reading() as connection:
            body = connection.scalar(sa.select(RECIPES.c.body).where(RECIPES.c.id == recipe))
        return () if body is None else recipe_of(recipe, body).labels

    def revision(self, name: str) -> int:
        """The map's revision; raises NotFound."""
        with self._database.reading() as connection:
            revision = connection.scalar(sa.select(MAPS.c.revision).where(MAPS.c.name == name))
        if revision is None:
            raise NotFound("map", name, NO_MAP)
        return int(revision)

    def counts(self, name: str) -> MapCounts:
        """Size of a map; raises NotFound."""
        with self._database.reading() as connection:
            own = VIEWS.c.map_id == find_map(connection, name).id
            row = connection.execute(sa.select(*_totals(connection)).where(own)).one()
            places = connection.execute(sa.select(_PLACES).where(own)).scalar_one()
        return _counts_of(row, places)

    def counts_of_all(self) -> dict[str, MapCounts]:
        """Sizes of all maps by their names, in one look."""
        by_map = VIEWS.c.map_id
        with self._database.reading() as connection:
            names = connection.execute(sa.select(MAPS.c.id, MAPS.c.name).where(MAPS.c.name.is_not(None))).all()
            totals = sa.select(by_map, *_totals(connection)).group_by(by_map)
            found = {row.map_id: row for row in connection.execute(totals)}
            places: dict[int, int] = {
                row[0]: row[1] for row in connection.execute(sa.select(by_map, _PLACES).group_by(by_map))
            }
            nothing = connection.execute(sa.select(*_totals(connection)).where(sa.false())).one()
        return {str(name): _counts_of(found.get(number, nothing), places.get(number, 0)) for number, name in names}

    def put(self, name: str, recipe: MapRecipe, now: datetime) -> tuple[MapRecord, bool]:
        """Create a map, or replace the recipe of an empty one; returns the map and whether it was created.

        Raises
        ------
        Conflict
            The map has views and another recipe.
        """
        with self._database.writing() as connection:
            row = connection.execute(sa.select(MAPS).where(MAPS.c.name == name)).one_or_none()
            if row is None:
                make_map(connection, name, recipe, now)
            elif (row.recipe, row.ranking) != (recipe.description.id, recipe.ranking.model_dump_json()):
                if has_views(connection, row.id):
                    raise Conflict(
                        f"the map {name!r} has views that were described by the recipe {row.recipe}; "
                        f"POST /maps/{name}/recipe describes them anew, PATCH /maps/{name} changes the ranking alone"
                    )
                kept = keep_recipe(connection, recipe.description)
                if kept != row.recipe:
                    switching.end_training(connection, row.id, now)
                switching.change_over(connection, row.id, kept, recipe.ranking.model_dump_json(), now)
            return map_record(connection, find_map(connection, name)), row is None

    def change(self, name: str, changes: MapChanges) -> MapRecord:
        """Change settings of a map, all of them in one transaction; those that take images away remove them then.

        Raises
        ------
        NotFound
        Conflict
            Words are to be blurred that are to be seen in images of the map's views; images are no longer to be kept,
            but a job reads them or the map has a shadow; or they are to be kept again, but those of views are gone.
        """

        def change(connection: sa.Connection) -> tuple[MapRecord, int | None]:
            forgets = map_settings.change(connection, name, changes)
            return map_record(connection, find_map(connection, name)), forgets

        if changes.frees:
            record, forgets = self._database.freeing(change)
        else:
            with self._database.writing() as connection:
                record, forgets = change(connection)
            self._database.stain()
        self._database.scrub()  # of kept queries
        if forgets is not None:
            forgetting.remove_all(self._database, self._images, forgets)
        return record

    def refuses_poor(self, name: str) -> bool:
        """Whether a map refuses poor images; False where there is no such map."""
        try:
            return self.get(name).refuse_poor
        except NotFound:
            return False

    def blur(self, name: str) -> tuple[str, ...]:
        """What a map blurs; empty where there is no such map."""
        with self._database.reading() as connection:
            try:
                return blur_of(find_map(connection, name))
            except NotFound:
                return ()

    def set_calibration(self, name: str, calibration: str | None, fitted_to: MapRecipe | None = None) -> MapRecord:
        """Give a map a calibration of its own, as JSON, or the shipped one again (None), as of its next revision.

        Parameters
        ----------
        name : str
        calibration : str or None
        fitted_to : MapRecipe or None
            By which the labelled queries were answered.

        Raises
        ------
        NotFound
        Conflict
            The map's scores no longer come from `fitted_to`.
        """
        with self._database.writing() as connection:
            row = find_map(connection, name)
            if fitted_to is not None and not switching.scores_alike(map_record(connection, row).recipe, fitted_to):
                raise Conflict(
                    f"the recipe or the ranking of the map {name!r} is no longer the one that answered the labelled "
                    "queries; query the map with them again"
                )
            if calibration != row.calibration:
                connection.execute(sa.update(MAPS).where(MAPS.c.id == row.id).values(calibration=calibration))
                clock.tick(connection, row.id)
            return map_record(connection, find_map(connection, name))
