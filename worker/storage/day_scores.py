"""Scores of sure matches of views, summed by day, where a map keeps queries that look unlike what they matched."""

from collections.abc import Mapping, Sequence
from datetime import date, timedelta
from typing import Any

import sqlalchemy as sa

from schemas.ageing import MOST_DAYS, DayScore, MatchedView
from schemas.comparisons import KnownView
from schemas.errors import Damaged
from schemas.recipe import MapRecipe
from worker.storage import checksums
from worker.storage.part import Part
from worker.storage.rows import attributes_of, batches, find_map, has_whole_attributes, log, map_record
from worker.storage.switching import scoring_basis
from worker.storage.tables import DAY_SCORES, MAPS, VIEWS

Days = dict[int, tuple[int, float]]
"""Of a view: from the day to the number of matches and the sum of their scores."""

_EPOCH = date(1970, 1, 1)


def drop_scores(connection: sa.Connection, map_id: int) -> None:
    """Delete all scores of a map."""
    connection.execute(sa.delete(DAY_SCORES).where(DAY_SCORES.c.map_id == map_id))


class DayScores(Part):
    """Scores of maps. They belong to their view, and are deleted with it."""

    def add(self, name: str, recipe: MapRecipe, scores: Mapping[int, Sequence[DayScore]]) -> None:
        """Add scores to those of the same view and day.

        Of a view the `MOST_DAYS` oldest and newest days stay, and only days whose scores come from the present recipe
        and ranking. Nothing is kept where the map keeps no matches or no longer scores by `recipe`, nor of views that
        were deleted.

        Parameters
        ----------
        scores : mapping of int to sequence of DayScore
            By the sequence number of the view.
        """
        with self._database.writing() as connection:
            row = connection.execute(sa.select(MAPS).where(MAPS.c.name == name)).one_or_none()
            if row is None or not row.keep_matches:
                return
            basis = scoring_basis(recipe)
            try:
                if scoring_basis(map_record(connection, row).recipe) != basis:
                    return
            except Damaged:
                return
            for portion in batches(scores):
                _merge(connection, row.id, basis, {seq: scores[seq] for seq in portion})

    def state(self, name: str) -> tuple[int, int]:
        """Two numbers of a map, one of which changes whenever a view is matched on a further day; raises NotFound."""
        with self._database.reading() as connection:
            own = DAY_SCORES.c.map_id == find_map(connection, name).id
            days = sa.select(sa.func.count(), sa.func.coalesce(sa.func.sum(DAY_SCORES.c.day), 0)).where(own)
            count, total = connection.execute(days).one()
        return int(count), int(total)

    def of(self, name: str) -> list[MatchedView]:
        """Views of a map with their scores by its present recipe and ranking, ascending by sequence number.

        Damaged rows and views are left out. Raises NotFound, Damaged.
        """
        with self._database.reading() as connection:
            row = find_map(connection, name)
            basis = scoring_basis(map_record(connection, row).recipe)
            own = DAY_SCORES.c.map_id == row.id, DAY_SCORES.c.basis == basis
            # Apart: with each of its days, the row of a view would be read some thirty times.
            wanted = sa.select(VIEWS).where(VIEWS.c.seq.in_(sa.select(DAY_SCORES.c.seq).where(*own)))
            views = {one.seq: (one, list[DayScore]()) for one in connection.execute(wanted.order_by(VIEWS.c.seq))}
            for one in connection.execute(sa.select(DAY_SCORES).where(*own).order_by(DAY_SCORES.c.day)):
                if one.seq not in views:
                    continue  # the number of the view is damaged
                view, days = views[one.seq]
                if checksums.is_whole(DAY_SCORES, one):
                    days.append(DayScore(_EPOCH + timedelta(days=one.day), one.matches, one.total))
                else:
                    log.error("view %s: its stored scores of one day are damaged; they are left out", view.id)
        return [_matched(one, days) for one, days in views.values() if days and has_whole_attributes(one)]


def _merge(connection: sa.Connection, map_id: int, basis: str, scores: Mapping[int, Sequence[DayScore]]) -> None:
    """Add scores to those of views; only rows that change are written."""
    there = sa.select(VIEWS.c.seq).where(VIEWS.c.map_id == map_id, VIEWS.c.seq.in_(list(scores)))
    old: dict[int, Days] = {int(seq): {} for seq in connection.scalars(there)}
    gone: list[dict[str, int]] = []
    for row in connection.execute(sa.select(DAY_SCORES).where(DAY_SCORES.c.seq.in_(list(old)))):
        if row.basis == basis and checksums.is_whole(DAY_SCORES, row):
            old[row.seq][row.day] = row.matches, row.total
        else:
            gone.append({"of_seq": row.seq, "of_day": row.day})
    rows = []
    for seq, days in old.items():
        new = _bounded(_added(days, scores[seq]))
        gone += [{"of_seq": seq, "of_day": day} for day, sums in days.items() if new.get(day) != sums]
        rows += [
            {"seq": seq, "day": day, "map_id": map_id, "basis": basis, "matches": sums[0], "total": sums[1]}
            for day, sums in new.items()
            if days.get(day) != sums
        ]
    if gone:
        which = DAY_SCORES.c.seq == sa.bindparam("of_seq"), DAY_SCORES.c.day == sa.bindparam("of_day")
        connection.execute(sa.delete(DAY_SCORES).where(*which), gone)
    if rows:
        connection.execute(sa.insert(DAY_SCORES), rows)


def _added(days: Days, scores: Sequence[DayScore]) -> Days:
    sums = dict(days)
    for score in scores:
        number = (score.day - _EPOCH).days
        count, total = sums.get(number, (0, 0.0))
        sums[number] = count + int(score.count), total + float(score.total)
    return sums


def _bounded(days: Days) -> Days:
    """The oldest days and the newest ones: what lies between tells nothing of a fall from those to these."""
    ordered = sorted(days)
    if len(ordered) > 2 * MOST_DAYS:
        ordered = ordered[:MOST_DAYS] + ordered[-MOST_DAYS:]
    return {day: days[day] for day in ordered}


def _matched(row: sa.Row[Any], days: Sequence[DayScore]) -> MatchedView:
    attributes = attributes_of(row)
    return MatchedView(row.id, KnownView(attributes.place, attributes.position, frozenset()), tuple(days))
