"""Conversion between rows and records."""

import json
import math
from collections.abc import Collection, Iterable, Iterator
from functools import cache, lru_cache
from typing import Any

import sqlalchemy as sa

from schemas.errors import NotFound
from schemas.image import ImageFacts
from schemas.recipe import DescriptionRecipe, RankingConfig
from schemas.records import DescriptionRecord, MapRecord, Position, ViewAttributes, ViewRecord
from worker.storage.packing import unpack_floats
from worker.storage.tables import DESCRIPTIONS, MAPS, RECIPES, VIEWS

COORDINATES = ("x", "y", "z", "lat", "lon", "alt", "heading")

# Statements that every enrolment runs are built once: building one takes longer than running it.
_MAP_NAMED = sa.select(MAPS).where(MAPS.c.name == sa.bindparam("of"))
_RECIPE = sa.select(RECIPES.c.body).where(RECIPES.c.id == sa.bindparam("of"))

BATCH = 500
"""Most values in one IN list."""


def batches(values: Iterable[Any]) -> Iterator[list[Any]]:
    """Values in lists of at most `BATCH`."""
    everything = list(values)
    for start in range(0, len(everything), BATCH):
        yield everything[start : start + BATCH]


def as_json(value: object) -> str:
    """Canonical JSON in ASCII: equal values give equal text."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"))


@cache
def inserting(table: sa.Table) -> sa.Insert:
    """The INSERT statement of a table, cached."""
    return sa.insert(table)


# maps


def find_map(connection: sa.Connection, name: str) -> sa.Row[Any]:
    """The row of a map; raises NotFound."""
    row = connection.execute(_MAP_NAMED, {"of": name}).one_or_none()
    if row is None:
        raise NotFound("map", name)
    return row


def maps_named(names: Collection[str]) -> sa.Select[Any]:
    """Selects the numbers of the maps with these names."""
    return sa.select(MAPS.c.id).where(MAPS.c.name.in_(names))


def keep_recipe(connection: sa.Connection, recipe: DescriptionRecipe) -> str:
    """Store a recipe unless it is stored; returns its id."""
    if connection.scalar(_RECIPE, {"of": recipe.id}) is None:
        connection.execute(sa.insert(RECIPES).values(id=recipe.id, body=recipe.model_dump_json()))
    return recipe.id


def find_recipe(connection: sa.Connection, recipe: str) -> DescriptionRecipe:
    """A stored recipe by its id."""
    return _recipe_of(str(connection.scalar(_RECIPE, {"of": recipe})))


@lru_cache(maxsize=64)
def _recipe_of(body: str) -> DescriptionRecipe:
    return DescriptionRecipe.model_validate_json(body)


def map_record(connection: sa.Connection, row: sa.Row[Any]) -> MapRecord:
    """A map from its row."""
    return map_by(find_recipe(connection, row.recipe), row)


def map_by(recipe: DescriptionRecipe, row: sa.Row[Any]) -> MapRecord:
    """A map from its row and its description recipe."""
    return MapRecord(row.name, row.revision, recipe, ranking_of(row.ranking), row.created_at, row.calibration)


@lru_cache(maxsize=64)
def ranking_of(body: str) -> RankingConfig:
    """A ranking from its JSON."""
    return RankingConfig.model_validate_json(body)


# views


@cache
def view_rows() -> sa.Select[Any]:
    """Selects views with their map's name and their description by the map's recipe, for `view_record`."""
    # A map without a name is being deleted: its views are no longer shown.
    named = sa.and_(MAPS.c.id == VIEWS.c.map_id, MAPS.c.name.is_not(None))
    described = sa.and_(DESCRIPTIONS.c.seq == VIEWS.c.seq, DESCRIPTIONS.c.recipe == MAPS.c.recipe)
    return sa.select(
        VIEWS,
        MAPS.c.name.label("map"),
        DESCRIPTIONS.c.recipe.label("recipe"),
        DESCRIPTIONS.c.descriptor_count,
        DESCRIPTIONS.c.static_share,
        DESCRIPTIONS.c.nodes,
        DESCRIPTIONS.c.label_shares,
    ).select_from(VIEWS.join(MAPS, named).outerjoin(DESCRIPTIONS, described))


def view_record(row: sa.Row[Any]) -> ViewRecord:
    """A view from a row of `view_rows`."""
    description = None
    if row.recipe is not None and row.state == "ready":
        description = DescriptionRecord(
            row.recipe, row.descriptor_count, row.static_share, unpack_floats(row.label_shares), row.nodes
        )
    return ViewRecord(
        id=row.id,
        seq=row.seq,
        map=row.map,
        attributes=attributes_of(row),
        enrolled_at=row.enrolled_at,
        image=ImageFacts(row.width, row.height, row.byte_count, row.format, row.sha256),
        state=row.state,
        failure=None if row.failure_code is None else (row.failure_code, row.failure_detail),
        description=description,
    )


def find_view(connection: sa.Connection, view_id: str) -> sa.Row[Any]:
    """The row of a view, as of `view_rows`; raises NotFound."""
    row = connection.execute(_view_of_id(), {"of": view_id}).one_or_none()
    if row is None:
        raise NotFound("view", view_id)
    return row


@cache
def views_of() -> sa.Select[Any]:
    """`view_rows` for the sequence numbers in the parameter ``seqs``."""
    seqs: sa.BindParameter[Any] = sa.bindparam("seqs", expanding=True)
    return view_rows().where(VIEWS.c.seq.in_(seqs))


@cache
def _view_of_id() -> sa.Select[Any]:
    return view_rows().where(VIEWS.c.id == sa.bindparam("of"))


# attributes of a view


def attributes_of(row: sa.Row[Any]) -> ViewAttributes:
    """Attributes from the row of a view."""
    position = Position(row.x, row.y, row.z, row.lat, row.lon, row.alt, row.heading)
    return ViewAttributes(row.place, position, row.captured_at, json.loads(row.metadata))


def attribute_columns(attributes: ViewAttributes) -> dict[str, Any]:
    """Attributes as columns of `views`."""
    # SQLite would store a numpy number as bytes, without an error.
    columns: dict[str, Any] = {
        name: None if (value := getattr(attributes.position, name)) is None else float(value) for name in COORDINATES
    }
    lat, lon = columns["lat"], columns["lon"]
    globe = (None, None, None) if lat is None or lon is None else unit_vector(lat, lon)
    columns["globe_x"], columns["globe_y"], columns["globe_z"] = globe
    columns["place"] = attributes.place
    columns["captured_at"] = attributes.captured_at
    columns["metadata"] = as_json(dict(attributes.metadata))
    return columns


def unit_vector(lat: float, lon: float) -> tuple[float, float, float]:
    """Degrees as a point (x, y, z) on the unit sphere, which has no seam at 180 degrees and no poles."""
    phi, theta = math.radians(lat), math.radians(lon)
    return math.cos(phi) * math.cos(theta), math.cos(phi) * math.sin(theta), math.sin(phi)
