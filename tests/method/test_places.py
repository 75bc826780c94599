"""Which views are of one place."""

import pytest

from schemas.comparisons import KnownView
from schemas.records import Position
from worker.method.places import Places


def at(x: float, y: float = 0.0, name: str | None = None, z: float | None = None) -> KnownView:
    return KnownView(name, Position(x=x, y=y, z=z))


def places(*known: KnownView) -> Places:
    return Places(dict(enumerate(known)), 5.0)


def test_a_name_makes_one_place_of_views_far_apart() -> None:
    hall = places(at(0, name="hall"), at(100, name="hall"), at(0.5, name=None))
    assert hall.same(0, 1)
    assert hall.same(0, 2)
    assert not hall.same(1, 2)


def test_views_without_name_or_position_are_places_of_their_own_unless_the_map_says_otherwise() -> None:
    alone = places(KnownView(), KnownView(), KnownView(same_spot=frozenset({0})))
    assert not alone.same(0, 1)
    assert alone.apart(0, 1)
    assert alone.same(0, 2)
    assert alone.same(2, 0)


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (at(0, name="lift, floor 1"), at(0.1, name="lift, floor 2"), True),  # so near that names do not matter
        (KnownView("lift, floor 1"), KnownView("lift, floor 2"), False),
        (KnownView("lift, floor 1"), KnownView(), True),
        (at(0), at(19), True),
        (at(0), at(21), False),
        (at(0), KnownView(), True),
    ],
)
def test_the_maps_comparison_does_not_overrule_the_user(one: KnownView, other: KnownView, same: bool) -> None:
    compared = KnownView(other.name, other.position, frozenset({0}))
    assert places(one, compared).same(0, 1) is same
    assert places(one, compared).same(1, 0) is same


@pytest.mark.parametrize(("gap", "same", "apart"), [(4.9, True, False), (5.1, False, False), (20.1, False, True)])
def test_neighbours_are_neither_the_same_place_nor_another(gap: float, same: bool, apart: bool) -> None:
    walk = places(at(0), at(gap))
    assert (walk.same(0, 1), walk.apart(0, 1)) == (same, apart)


def test_floors_above_each_other_are_apart_where_heights_are_given() -> None:
    assert places(at(0, z=0), at(0, z=30)).apart(0, 1)
    assert places(at(0, z=0), at(0)).same(0, 1)


@pytest.mark.parametrize(
    ("one", "other", "same", "apart", "told_apart"),
    [
        (at(0, name="lift 1", z=0), at(0, name="lift 2", z=3), False, True, True),
        (at(0, name="lift 1", z=0), at(4, name="stairs 2", z=3), False, True, True),
        (at(0, name="lift 1", z=0), at(0, name="lift 2", z=1.9), True, False, False),  # a step, or a hand held higher
        (at(0, name="lift", z=0), at(0, name="lift", z=3), True, False, False),
        (at(0, z=0), at(0, z=3), True, False, False),  # without names, heights drift as positions do
        (at(0, name="path 1", z=0), at(19, name="path 2", z=3), False, False, False),  # a slope
    ],
)
def test_two_names_above_each_other_are_two_storeys(
    one: KnownView, other: KnownView, same: bool, apart: bool, told_apart: bool
) -> None:
    house = places(one, other)
    assert (house.same(0, 1), house.apart(1, 0), house.told_apart(0, 1)) == (same, apart, told_apart)


def test_heights_of_satellite_positions_make_no_storeys() -> None:
    shop, bakery = (
        KnownView(name, Position(lat=48.0, lon=11.0, alt=alt)) for name, alt in (("shop", 520), ("bakery", 523))
    )
    house = places(shop, bakery)
    assert (house.same(0, 1), house.apart(0, 1), house.told_apart(0, 1)) == (True, False, False)
    assert house.positions(0) == [shop.position, bakery.position]


def test_an_estimate_asks_for_positions_of_one_storey_of_one_map() -> None:
    below, above, unnamed = at(0, name="lift 1", z=0), at(1, name="lift 2", z=3), at(2, z=3)
    other_map = KnownView("lift 3", Position(x=3, y=0), map=1)
    house = places(below, above, unnamed, other_map)
    assert house.positions(0) == [below.position, unnamed.position]


def test_degrees_are_measured_in_metres_and_never_compared_with_metres() -> None:
    greenwich = KnownView(position=Position(lat=51.4779, lon=0.0))
    across = KnownView(position=Position(lat=51.4779, lon=0.00005))  # 3.5 m
    assert places(greenwich, across).same(0, 1)
    assert places(greenwich, at(0)).apart(0, 1)


def test_a_place_is_that_of_its_best_view() -> None:
    chain = places(at(0), at(4), at(8), at(50))
    assert chain.group([1, 3, 0, 2]) == [[0, 2, 3], [1]]
    assert chain.group([0, 1, 2, 3]) == [[0, 1], [2], [3]]
