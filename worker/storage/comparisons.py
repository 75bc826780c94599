"""Comparisons of views with the other views of their map."""

import json
from collections.abc import Sequence
from datetime import datetime
from functools import cache
from typing import Any

import numpy as np
import sqlalchemy as sa

from schemas.comparisons import Comparison, KnownView, MapLevels
from schemas.draw import draw_order
from schemas.health import SurveyedView, Uncompared
from schemas.latest import Latest
from schemas.recipe import MapRecipe
from worker.storage import checksums, clock, switching
from worker.storage.database import Database
from worker.storage.image_store import ImageStore
from worker.storage.part import Part
from worker.storage.rows import attributes_of, batches, find_map, has_whole_attributes, log, ranking_of
from worker.storage.tables import COMPARISONS, DESCRIPTIONS, MAPS, VIEWS

NOTHING: frozenset[int] = frozenset()

OWN_QUANTILE = 0.9
"""Quantile of the scores between views of one place: a high one, as a name may be given to views that share nothing."""

SMALL = 40
"""A map of at most this many views is compared again whenever their number changed, a larger map when the number has
doubled: compared with twenty others or more, a view finds what it finds in a map of any size."""

MOST_KEPT = 1000
"""Maps whose levels are kept in memory while they do not change."""

DECIMALS = 12
"""Decimals to which means are rounded. A database adds rows in any order, which changes the last bits of a sum.
Rounded, the same views get the same answers."""


def outdate(connection: sa.Connection, map_id: int, seqs: Sequence[int]) -> None:
    """Mark views of a map to be compared again, because the views `seqs` are about to be deleted or moved to another
    place.

    In a small map these are all that were compared with one of `seqs`, else those whose strongest rival is one of
    these. What was measured of them counts until they are compared again.
    """
    recipe = connection.scalar(sa.select(MAPS.c.recipe).where(MAPS.c.id == map_id))
    own = DESCRIPTIONS.c.map_id == map_id, DESCRIPTIONS.c.recipe == recipe
    some = sa.select(DESCRIPTIONS.c.seq).where(*own).limit(SMALL + 1).subquery()
    count = connection.scalar(sa.select(sa.func.count()).select_from(some)) or 0
    mine = sa.update(COMPARISONS).where(COMPARISONS.c.map_id == map_id)
    for portion in batches(seqs):
        affected: sa.ColumnElement[bool]
        if count > SMALL:
            affected = COMPARISONS.c.rival.in_(portion)
        else:  # a view is compared with those described before: `among` says up to which one
            first = sa.select(sa.func.min(DESCRIPTIONS.c.revision)).where(*own, DESCRIPTIONS.c.seq.in_(portion))
            before = sa.select(sa.func.count()).where(*own, DESCRIPTIONS.c.revision < first.scalar_subquery())
            affected = (COMPARISONS.c.among > (connection.scalar(before) or 0)) | (COMPARISONS.c.recipe != recipe)
        connection.execute(mine.where(affected).values(among=0))


class Comparisons(Part):
    """What views find when their own map is queried with them, and what is known of views besides their images."""

    def __init__(self, database: Database, images: ImageStore) -> None:
        super().__init__(database, images)
        self._levels: Latest[tuple[int, str], MapLevels] = Latest(MOST_KEPT)
        # By sample and busy, see `uncompared`: the maps in which nothing was due, and their revisions then.
        self._nothing_due: dict[tuple[int, bool], dict[int, int]] = {}

    def last_revision(self) -> int:
        """The last revision given to any map: while it stays, nothing new is due."""
        with self._database.reading() as connection:
            return clock.read(connection)

    def uncompared(self, sample: int, count: int, *, busy: bool = False) -> Uncompared | None:
        """Up to `count` views, of one map, that should be compared, or None.

        Parameters
        ----------
        sample : int
            Views of each map that are compared at most; a larger map is sampled.
        count : int
        busy : bool
            Leave small maps too until they have doubled.
        """
        known, settled = self._nothing_due.get((sample, busy), {}), dict[int, int]()
        with self._database.reading() as connection:
            for row in connection.execute(_MAPS):
                if known.get(row.id) == row.revision:  # of thousands of maps most are as they were
                    settled[row.id] = row.revision
                    continue
                among = connection.scalar(_ready(), {"map": row.id, "recipe": row.recipe}) or 0
                named = COMPARISONS.c.level.is_(None) | _has_rival(row)  # named since migration 0010
                broad = COMPARISONS.c.gap.is_(None) | COMPARISONS.c.breadth.is_not(None)  # since migration 0017
                fresh = (*_of(row), _current(among, small=among <= SMALL and not busy), named, broad)
                done = connection.scalar(sa.select(sa.func.count()).select_from(COMPARISONS).where(*fresh)) or 0
                left = min(count, min(among, sample) - done)
                if among < 2 or left <= 0:
                    settled[row.id] = row.revision
                    continue
                made = sa.exists().where(COMPARISONS.c.seq == DESCRIPTIONS.c.seq, *fresh)
                due = (
                    sa.select(DESCRIPTIONS.c.seq)
                    .where(*_described(row), ~made)
                    .order_by(draw_order(DESCRIPTIONS.c.seq))
                    .limit(left)
                )
                self._nothing_due[sample, busy] = known | settled
                return Uncompared(row.name, row.recipe, tuple(connection.scalars(due)), among)
        self._nothing_due[sample, busy] = settled
        return None

    def keep(
        self, name: str, by: MapRecipe, comparisons: Sequence[Comparison], now: datetime, as_of: int | None = None
    ) -> None:
        """Store comparisons made by the recipe and ranking `by`; each one replaces what was stored of its view.

        Those of views that were deleted or described anew are left out. Nothing is stored when the map was deleted,
        when its ranking by now gives other scores than that in `by`, or when attributes of its views were changed since
        its revision `as_of`. Comparisons by the map's recipe count from its next revision on, those by the recipe of
        its shadow from the switch on.
        """
        recipe = by.description.id
        with self._database.writing() as connection:
            row = connection.execute(sa.select(MAPS).where(MAPS.c.name == name)).one_or_none()
            rankings = {} if row is None else {row.next_recipe: row.next_ranking, row.recipe: row.ranking}
            if row is None or recipe not in rankings or (as_of is not None and row.edited > as_of):
                return
            present = MapRecipe(description=by.description, ranking=ranking_of(rankings[recipe]))
            if not switching.scores_alike(by, present):
                return
            seqs = [seq for one in comparisons for seq in (one.seq, one.rival) if seq is not None]
            own = DESCRIPTIONS.c.map_id == row.id, DESCRIPTIONS.c.recipe == recipe
            there = sa.select(DESCRIPTIONS.c.seq).where(*own, DESCRIPTIONS.c.seq.in_(seqs))
            left = set(connection.scalars(there))
            rows = [
                {
                    "seq": one.seq,
                    "recipe": recipe,
                    "map_id": row.id,
                    "among": one.among,
                    "others": one.others,
                    "level": one.level,
                    "gap": one.gap,
                    "made_at": now,
                    "same_spot": json.dumps([int(seq) for seq in one.same_spot]),
                    "rival": one.rival,
                    "own": one.own,
                    "breadth": one.breadth,
                }
                for one in comparisons
                if one.seq in left and (one.rival is None or one.rival in left)
            ]
            if rows:
                old = COMPARISONS.c.recipe == recipe, COMPARISONS.c.seq.in_([one["seq"] for one in rows])
                connection.execute(sa.delete(COMPARISONS).where(*old))
                connection.execute(sa.insert(COMPARISONS), rows)
                if recipe == row.recipe:
                    clock.tick(connection, row.id)

    def levels(self, name: str, recipe: str | None = None) -> MapLevels:
        """What the compared views of a map got, by its recipe or another one; raises NotFound."""
        with self._database.reading() as connection:
            row = find_map(connection, name)
            key = row.id, recipe or row.recipe
            kept = self._levels.get(key)
            if kept is not None and kept.revision == row.revision:
                return kept
            described = connection.scalar(_ready(), {"map": row.id, "recipe": row.recipe}) or 0
            levels = _levels(connection, row, key[1], described)
        if key[1] == row.recipe:  # comparisons by another one give the map no revision
            self._levels[key] = levels
        return levels

    def survey(self, name: str, most: int) -> tuple[list[SurveyedView], int]:
        """The newest `most` described views of a map with their comparisons, and how many views are described.

        Ascending by sequence number; damaged views are left out. Raises NotFound.
        """
        with self._database.reading() as connection:
            row = find_map(connection, name)
            described = connection.scalar(_ready(), {"map": row.id, "recipe": row.recipe}) or 0
            newest = sa.select(DESCRIPTIONS.c.seq).where(*_described(row)).order_by(DESCRIPTIONS.c.seq.desc())
            wanted = sa.select(VIEWS, *_compared_columns()).outerjoin(COMPARISONS, _compared_by())
            wanted = wanted.where(VIEWS.c.seq.in_(newest.limit(most)))
            rows = [of for of in connection.execute(wanted, {"recipe": row.recipe}) if has_whole_attributes(of)]
        return sorted((_surveyed(of) for of in rows), key=lambda view: view.seq), described

    def known(self, seqs: Sequence[int], recipe: str) -> dict[int, KnownView]:
        """Name, position and comparison of views by sequence number; deleted and damaged views are absent."""
        found: dict[int, KnownView] = {}
        damaged: list[int] = []
        with self._database.reading() as connection:
            for portion in batches(int(seq) for seq in seqs):
                for row in connection.execute(_known(), {"seqs": portion, "recipe": recipe}):
                    if not has_whole_attributes(row):
                        damaged.append(row.seq)
                        continue
                    known = attributes_of(row)
                    found[row.seq] = KnownView(known.place, known.position, _same_spot(row))
        self._quarantine.views(damaged)
        return found


_MAPS: sa.Select[Any] = (
    sa.select(MAPS.c.id, MAPS.c.name, MAPS.c.recipe, MAPS.c.revision)
    .where(MAPS.c.name.is_not(None))
    .order_by(MAPS.c.id)
)


def _of(row: sa.Row[Any]) -> tuple[sa.ColumnElement[bool], ...]:
    return COMPARISONS.c.map_id == row.id, COMPARISONS.c.recipe == row.recipe


def _current(among: int | sa.BindParameter[Any], *, small: bool) -> sa.ColumnElement[bool]:
    """Whether a comparison still says what it would say in a map that has `among` views now; in a `small` one all do
    that were made among as many."""
    return COMPARISONS.c.among == among if small else COMPARISONS.c.among * 2 > among


def _has_rival(row: sa.Row[Any]) -> sa.ColumnElement[bool]:
    """Whether the rival of a comparison is searched. Up to 0.3.0 it could be deleted without `outdate`."""
    rivals = DESCRIPTIONS.alias()
    return sa.exists().where(rivals.c.seq == COMPARISONS.c.rival, rivals.c.recipe == row.recipe)


def _described(row: sa.Row[Any]) -> tuple[sa.ColumnElement[bool], ...]:
    return DESCRIPTIONS.c.map_id == row.id, DESCRIPTIONS.c.recipe == row.recipe


@cache
def _ready() -> sa.Select[Any]:
    """Counts the described views of the map and recipe in the parameters."""
    return sa.select(sa.func.count()).select_from(DESCRIPTIONS).where(*_by_parameters(DESCRIPTIONS))


def _by_parameters(table: sa.Table) -> tuple[sa.ColumnElement[bool], ...]:
    """The rows of the map and the recipe in the parameters ``map`` and ``recipe``."""
    return table.c.map_id == sa.bindparam("map"), table.c.recipe == sa.bindparam("recipe")


@cache
def _known() -> sa.Select[Any]:
    seqs: sa.BindParameter[Any] = sa.bindparam("seqs", expanding=True)
    return sa.select(VIEWS, *_compared_columns()).outerjoin(COMPARISONS, _compared_by()).where(VIEWS.c.seq.in_(seqs))


def _compared_columns() -> list[sa.Label[Any]]:
    return checksums.labelled(COMPARISONS, "compared")


def _compared_by() -> sa.ColumnElement[bool]:
    """The comparison of a view by the recipe in the parameter ``recipe``."""
    recipe: sa.BindParameter[Any] = sa.bindparam("recipe")
    return (COMPARISONS.c.seq == VIEWS.c.seq) & (COMPARISONS.c.recipe == recipe)


def _surveyed(row: sa.Row[Any]) -> SurveyedView:
    attributes, same_spot = attributes_of(row), _whole_same_spot(row)
    known = KnownView(attributes.place, attributes.position, same_spot or NOTHING)
    if same_spot is None:
        return SurveyedView(row.id, row.seq, known, row.enrolled_at, None)
    spots = tuple(sorted(same_spot))
    facts = (getattr(row, f"compared_{name}") for name in ("among", "others", "rival", "own", "breadth"))
    return SurveyedView(
        row.id,
        row.seq,
        known,
        row.enrolled_at,
        Comparison(row.seq, row.compared_level, row.compared_gap, spots, *facts),
    )


def _same_spot(row: sa.Row[Any]) -> frozenset[int]:
    """Views of the same spot by the comparison in a row of `_known`; nothing when there is none, or it is damaged."""
    return _whole_same_spot(row) or NOTHING


def _whole_same_spot(row: sa.Row[Any]) -> frozenset[int] | None:
    """As `_same_spot`; None when there is no comparison, or it is damaged."""
    if row.compared_same_spot is None:
        return None
    try:
        if not checksums.is_whole_labelled(COMPARISONS, row._mapping, "compared"):
            raise ValueError("the row does not fit its checksum")
        return frozenset(json.loads(row.compared_same_spot)) if row.compared_same_spot else NOTHING
    except ValueError:
        log.error("view %s: its stored comparison with its map is damaged; it is left out", row.id)
        return None


@cache
def _means(*, small: bool) -> sa.Select[Any]:
    """What the comparisons of a map that has ``described`` views say together, in one row."""
    # Within the range of scores: one damaged number must not carry the mean away.
    level, gap = (sa.case((column.between(0, 1), column)) for column in (COMPARISONS.c.level, COMPARISONS.c.gap))
    breadth = sa.case((COMPARISONS.c.breadth.between(0, 1000), COMPARISONS.c.breadth))
    means = (sa.func.avg(column) for column in (breadth, level, gap, COMPARISONS.c.others))
    current = sa.case((_current(sa.bindparam("described"), small=small), 1))
    counts = sa.func.count(level), sa.func.count(current), sa.func.max(COMPARISONS.c.made_at)
    return sa.select(*counts, *means).where(*_by_parameters(COMPARISONS))


@cache
def _own() -> sa.Select[Any]:
    whole = COMPARISONS.c.level.is_not(None), COMPARISONS.c.own.between(0, 1)
    return sa.select(COMPARISONS.c.own).where(*_by_parameters(COMPARISONS), *whole)


def _levels(connection: sa.Connection, row: sa.Row[Any], recipe: str, described: int) -> MapLevels:
    of = {"map": row.id, "recipe": recipe}
    found = connection.execute(_means(small=described <= SMALL), of | {"described": described})
    count, up_to_date, latest, broad, *mean = found.one()
    own = [float(value) for value in connection.scalars(_own(), of)]
    level_mean, gap_mean, others = (round(float(value or 0), DECIMALS) for value in mean)
    return MapLevels(
        count,
        level_mean,
        gap_mean,
        others,
        latest,
        row.revision,
        breadth=None if broad is None else round(float(broad), DECIMALS),
        own=float(np.quantile(own, OWN_QUANTILE)) if own else None,
        paired=len(own),
        current=up_to_date,
    )
