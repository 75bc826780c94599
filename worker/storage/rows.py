"""Conversion between rows and records."""

import json
import logging
from collections.abc import Collection, Iterable, Iterator, Mapping
from functools import cache, lru_cache
from typing import Any

import sqlalchemy as sa

from schemas.blur import BLUR_WORDS
from schemas.errors import Damaged, NotFound
from schemas.globe import unit_vector
from schemas.image import ImageFacts
from schemas.recipe import DescriptionRecipe, RankingConfig
from schemas.records import DescriptionRecord, Failure, MapRecord, Position, ViewAttributes, ViewRecord
from schemas.values import composed
from worker.storage import checksums
from worker.storage.packing import unpack_floats
from worker.storage.tables import DESCRIPTIONS, MAPS, RECIPES, VIEWS

log = logging.getLogger("revisit.storage")

_PLACES = {column.name: at for at, column in enumerate(VIEWS.columns)}
_COVERED = [(name, _PLACES[name]) for name in checksums.COVERED[VIEWS.name]]
_CHECKSUM = _PLACES["checksum"]

VIEW_STATES = ("pending", "ready", "failed")

FORMATS = ("png", "jpeg", "webp", "bmp", "tiff", "heic")

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


def has_views(connection: sa.Connection, map_id: int) -> bool:
    """Whether a map has any view, in whatever state."""
    return connection.scalar(sa.select(VIEWS.c.seq).where(VIEWS.c.map_id == map_id).limit(1)) is not None


NO_MAP = "GET /maps lists all there are; the first enrolment into a map makes it"


def find_map(connection: sa.Connection, name: str) -> sa.Row[Any]:
    """The row of a map; raises NotFound."""
    row = connection.execute(_MAP_NAMED, {"of": name}).one_or_none()
    if row is None:
        raise NotFound("map", name, NO_MAP)
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
    """A stored recipe by its id; raises Damaged."""
    return recipe_of(recipe, str(connection.scalar(_RECIPE, {"of": recipe})))


@lru_cache(maxsize=64)
def recipe_of(recipe: str, body: str) -> DescriptionRecipe:
    """A recipe from its JSON; raises Damaged when that is not of this id, which is a hash of it."""
    try:
        found = DescriptionRecipe.model_validate_json(body)
    except ValueError:
        found = None
    if found is None or found.id != recipe:
        raise Damaged(f"the stored recipe {recipe} is damaged, so that its maps cannot be searched; restore a backup")
    return found


def blur_of(row: sa.Row[Any]) -> tuple[str, ...]:
    """What a map blurs; everything that a word names where the row is damaged so that it cannot be read."""
    if row.blur is None:
        return ()
    try:
        words = json.loads(row.blur)
    except (TypeError, ValueError):
        return BLUR_WORDS
    return tuple(words) if isinstance(words, list) and all(isinstance(word, str) for word in words) else BLUR_WORDS


def map_record(connection: sa.Connection, row: sa.Row[Any]) -> MapRecord:
    """A map from its row."""
    return map_by(find_recipe(connection, row.recipe), row)


def map_by(recipe: DescriptionRecipe, row: sa.Row[Any]) -> MapRecord:
    """A map from its row and its description recipe."""
    ranking, calibration = ranking_of(row.ranking), row.calibration
    keep, keep_matches = row.keep_queries or 0, row.keep_matches or 0
    refuse_poor, keep_images, shadow = bool(row.refuse_poor), not row.drop_images, row.shadow
    if not checksums.is_whole(MAPS, row):
        calibration = None  # the shipped one is right for every map, if less sharp
        keep, keep_matches, refuse_poor, keep_images, shadow = 0, 0, False, True, None
        log.error(
            "map %s: its stored settings do not fit their checksum; it is searched with %s, without a calibration of "
            "its own; `./revisit doctor` says more",
            row.name,
            ranking,
        )
    return MapRecord(
        name=row.name,
        revision=row.revision,
        description=recipe,
        ranking=ranking,
        created_at=row.created_at,
        calibration=calibration,
        keep_queries=keep,
        refuse_poor=refuse_poor,
        keep_matches=keep_matches,
        keep_images=keep_images,
        shadow=shadow,
        blur=blur_of(row),
        following=row.next_recipe,
        number=row.id,
    )


@lru_cache(maxsize=64)
def ranking_of(body: str) -> RankingConfig:
    """A ranking from its JSON; the default one when that is damaged."""
    try:
        return RankingConfig.model_validate_json(body)
    except ValueError:
        return RankingConfig()


# views


@cache
def view_rows(*, by_given: bool = False) -> sa.Select[Any]:
    """Selects views with their map's name and their description, for `view_record`.

    The description is that by the map's recipe; `by_given`: by the recipe in the parameter ``recipe``.
    """
    recipe = sa.bindparam("recipe", type_=sa.Text) if by_given else MAPS.c.recipe
    # A map without a name is being deleted: its views are no longer shown.
    named = sa.and_(MAPS.c.id == VIEWS.c.map_id, MAPS.c.name.is_not(None))
    described = sa.and_(DESCRIPTIONS.c.seq == VIEWS.c.seq, DESCRIPTIONS.c.recipe == recipe)
    return sa.select(
        VIEWS,
        MAPS.c.name.label("map"),
        DESCRIPTIONS.c.recipe.label("recipe"),
        DESCRIPTIONS.c.descriptor_count,
        DESCRIPTIONS.c.static_share,
        DESCRIPTIONS.c.nodes,
        DESCRIPTIONS.c.label_shares,
        DESCRIPTIONS.c.map_id.label("described_map"),
        DESCRIPTIONS.c.revision.label("described_revision"),
        DESCRIPTIONS.c.checksum.label("described_checksum"),
    ).select_from(VIEWS.join(MAPS, named).outerjoin(DESCRIPTIONS, described))


def view_record(row: sa.Row[Any]) -> ViewRecord:
    """A view from a row of `view_rows`."""
    if not has_whole_attributes(row):
        return _damaged_record(row)
    description, state = None, row.state
    failure = None if row.failure_code is None else Failure(row.failure_code, row.failure_detail)
    if row.state not in VIEW_STATES:
        state, failure = "failed", Failure(Damaged.code, "its stored state is damaged")
    elif row.recipe is not None and row.state == "ready":
        if not has_whole_facts(row):
            state, failure = "failed", Failure(Damaged.code, "its description is damaged")
        else:
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
        state=state,
        failure=failure,
        description=description,
    )


def has_whole_attributes(row: sa.Row[Any]) -> bool:
    """Whether the attributes and the facts of a view fit their checksum; of a row that begins with `views`."""
    try:
        return bool(checksums.of_values([(name, row[at]) for name, at in _COVERED]) == row[_CHECKSUM])
    except (OverflowError, UnicodeError):
        return False


def has_whole_facts(row: sa.Row[Any]) -> bool:
    """Whether the facts of the description in a row of `view_rows` fit their checksum."""
    moved = {"map_id": row.described_map, "revision": row.described_revision}
    facts = [(name, moved.get(name, value)) for name, value in description_facts(row)]
    try:
        return bool(checksums.of_values(facts) == row.described_checksum)
    except (OverflowError, UnicodeError):
        return False


def description_facts(row: sa.Row[Any]) -> list[tuple[str, Any]]:
    """Covered columns of a description, (name, value) each."""
    return [(name, getattr(row, name, None)) for name in checksums.COVERED[DESCRIPTIONS.name]]


def _damaged_record(row: sa.Row[Any]) -> ViewRecord:
    """A view with damaged attributes: none of them is shown, since any may be wrong."""
    sizes = [size if isinstance(size, int) and size > 0 else 1 for size in (row.width, row.height, row.byte_count)]
    kind = row.format if row.format in FORMATS else FORMATS[0]
    detail = row.failure_detail if row.failure_code == Damaged.code else "its stored attributes are damaged"
    return ViewRecord(
        id=row.id,
        seq=row.seq,
        map=row.map,
        attributes=ViewAttributes(),
        enrolled_at=row.enrolled_at,
        image=ImageFacts(sizes[0], sizes[1], sizes[2], kind, str(row.sha256)),
        state="failed",
        failure=Failure(Damaged.code, str(detail)),
        description=None,
    )


def find_view(connection: sa.Connection, view_id: str) -> sa.Row[Any]:
    """The row of a view, as of `view_rows`; raises NotFound."""
    row = connection.execute(_view_of_id(), {"of": view_id}).one_or_none()
    if row is None:
        raise NotFound("view", view_id)
    return row


@cache
def views_of(*, by_given: bool = False) -> sa.Select[Any]:
    """`view_rows` for the sequence numbers in the parameter ``seqs``."""
    seqs: sa.BindParameter[Any] = sa.bindparam("seqs", expanding=True)
    return view_rows(by_given=by_given).where(VIEWS.c.seq.in_(seqs))


@cache
def _view_of_id() -> sa.Select[Any]:
    return view_rows().where(VIEWS.c.id == sa.bindparam("of"))


def change_view(connection: sa.Connection, row: sa.Row[Any], columns: Mapping[str, Any]) -> None:
    """Set columns of a view whose row was read in the same transaction, and its checksum by them."""
    checksum = checksums.of_row(VIEWS, {**row._mapping, **columns})
    connection.execute(sa.update(VIEWS).where(VIEWS.c.seq == row.seq).values(**columns, checksum=checksum))


# attributes of a view


def attributes_of(row: sa.Row[Any]) -> ViewAttributes:
    """Attributes from the row of a view; the name of its place composed, as it was not always kept."""
    place = None if row.place is None else composed(row.place)
    position = Position(row.x, row.y, row.z, row.lat, row.lon, row.alt, row.heading)
    return ViewAttributes(place, position, row.captured_at, json.loads(row.metadata), row.filename)


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
    columns["filename"] = attributes.filename
    return columns
