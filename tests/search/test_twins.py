"""Pairs of places that a map takes for each other, however many there are."""

from collections.abc import Iterator
from datetime import UTC, datetime

from schemas.comparisons import Comparison, KnownView, MapLevels
from schemas.health import HealthFinding, SurveyedView
from tests.storage.material import RECIPE
from worker.service.calibrations import shipped_calibration
from worker.service.match_standard import MatchStandard
from worker.service.twins import find_twins

LEVELS = MapLevels(2000, 0.3, 0.05, 1000.0, None, 1)
STANDARD = MatchStandard(0.97, LEVELS, shipped_calibration(RECIPE))
PLACE_M = RECIPE.ranking.same_place_m


class Watched(list[SurveyedView]):
    """Views that count how often they are gone through."""

    times = 0

    def __iter__(self) -> Iterator[SurveyedView]:
        self.times += 1
        return super().__iter__()


def view(seq: int, place: str, same_spot: tuple[int, ...]) -> SurveyedView:
    """A view whose comparison says of these that they show its spot."""
    compared = Comparison(seq, level=None, gap=None, same_spot=same_spot, among=1000, others=1000)
    return SurveyedView(f"view {seq}", seq, KnownView(place), datetime(2026, 1, 1, tzinfo=UTC), compared)


def twins(views: list[SurveyedView]) -> list[HealthFinding]:
    return list(find_twins(views, PLACE_M, STANDARD))


def test_views_are_gone_through_as_often_for_many_pairs_as_for_one() -> None:
    def floors(count: int) -> Watched:
        """Rooms of which each looks like the one above."""
        sides = ((2 * i + side, f"{side + 1}.{i}", (2 * i + 1 - side,)) for i in range(count) for side in (0, 1))
        return Watched(view(*side) for side in sides)

    one, many = floors(1), floors(300)
    assert [found.places for found in twins(one)] == [("1.0", "2.0")]
    assert len(twins(many)) == 300
    assert many.times == one.times


def test_two_places_of_many_views_are_one_finding_that_names_those_met_first() -> None:
    views = [view(seq, f"hall {seq % 2}", (seq ^ 1,)) for seq in range(3000)]
    [found] = twins(views)
    assert (found.places, found.count) == (("hall 0", "hall 1"), 3000)
    assert found.views == tuple(f"view {seq}" for seq in range(10))
