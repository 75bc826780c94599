"""The position of a query, from the matches that agree."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from schemas.records import Position
from worker.method.estimate import locate


def test_agreeing_matches_are_averaged_by_weight_and_outliers_left_out() -> None:
    fix = locate([Position(x=0, y=0), Position(x=10, y=0), Position(x=500, y=0)], [0.6, 0.3, 0.1])
    assert fix is not None
    assert fix.agreeing == (0, 1)
    assert fix.position.x == pytest.approx(10 / 3)
    assert fix.radius_m == pytest.approx(np.sqrt(2 / 3 * (10 / 3) ** 2 + 1 / 3 * (20 / 3) ** 2))
    assert fix.position.z is None


def test_without_a_position_of_the_best_match_there_is_no_estimate() -> None:
    assert locate([Position(heading=3.0), Position(x=1, y=2)], [0.9, 0.1]) is None
    assert locate([], []) is None


def test_metres_and_degrees_never_mix() -> None:
    fix = locate([Position(lat=50.0, lon=14.0), Position(x=0, y=0)], [0.5, 0.5])
    assert fix is not None
    assert fix.agreeing == (0,)
    assert fix.radius_m is None


def test_the_antimeridian_is_no_obstacle() -> None:
    fix = locate([Position(lat=0.0, lon=179.9999), Position(lat=0.0, lon=-179.9999)], [0.5, 0.5])
    assert fix is not None
    assert fix.agreeing == (0, 1)
    assert abs(fix.position.lon or 0) == pytest.approx(180, abs=1e-6)


def test_heights_are_averaged_when_all_are_known() -> None:
    fix = locate([Position(x=0, y=0, z=2.0), Position(x=0, y=0, z=4.0)], [0.5, 0.5])
    assert fix is not None
    assert fix.position.z == pytest.approx(3)


def test_a_view_without_a_height_does_not_take_it_from_the_others() -> None:
    floor = locate([Position(x=0, y=0, z=190.0), Position(x=1, y=0), Position(x=2, y=0, z=194.0)], [0.6, 0.3, 0.2])
    assert floor is not None
    assert floor.position.z == pytest.approx(191)
    phone = locate([Position(lat=50, lon=14, alt=190.0), Position(lat=50, lon=14)], [0.999, 0.0])
    assert phone is not None
    assert phone.position.alt == pytest.approx(190)
    unknown = locate([Position(x=0, y=0), Position(x=1, y=0, z=190.0)], [0.9, 0.1])  # the second says little
    assert unknown is not None
    assert unknown.position.z is None


@given(st.floats(-89, 89), st.floats(-180, 180), st.floats(-10, 10), st.floats(-10, 10))
def test_a_single_match_is_its_own_estimate(lat: float, lon: float, x: float, y: float) -> None:
    fix = locate([Position(lat=lat, lon=lon)], [0.0])
    assert fix is not None
    assert fix.position.lat == pytest.approx(lat)
    assert ((fix.position.lon or 0.0) - lon + 180) % 360 - 180 == pytest.approx(0, abs=1e-9)
    flat = locate([Position(x=x, y=y)], [1.0])
    assert flat is not None
    assert (flat.position.x, flat.position.y) == pytest.approx((x, y))


def test_one_view_is_as_exact_as_the_map_is_dense() -> None:
    walk = [Position(x=10.0, y=0.0), Position(x=13.0, y=0.0), Position(x=40.0, y=0.0), Position(lat=50.0, lon=14.0)]
    fix = locate(walk[:1], [0.9], walk)
    assert fix is not None
    assert fix.radius_m == pytest.approx(3.0)
    alone = locate(walk[:1], [0.9], walk[3:])
    assert alone is not None
    assert alone.radius_m is None


def test_a_view_that_stands_alone_is_no_more_exact_for_having_others_beside_it() -> None:
    walk = [Position(x=10.0, y=0.0), Position(x=22.0, y=0.0), Position(x=34.0, y=0.0)]
    sure, torn = locate(walk, [0.999, 0.001, 0.0], walk), locate(walk[:2], [0.5, 0.5], walk)
    assert sure is not None
    assert torn is not None
    assert sure.radius_m == pytest.approx(12, rel=0.01)  # not the centimetres by which the others pull
    assert torn.radius_m == pytest.approx(6)


def test_several_views_of_one_point_are_one_point() -> None:
    here, there = [Position(x=0.0, y=0.0)] * 3, Position(x=8.0, y=0.0)
    fix = locate([*here, there], [0.3, 0.3, 0.3, 0.0], [*here, there])
    assert fix is not None
    assert fix.radius_m == pytest.approx(8)


@given(st.lists(st.tuples(st.floats(-12, 12), st.floats(-12, 12), st.floats(0, 1)), min_size=2, max_size=6))
def test_no_radius_is_smaller_than_the_map_is_dense(views: list[tuple[float, float, float]]) -> None:
    positions = [Position(x=x, y=y) for x, y, _ in views]
    fix = locate(positions, [weight for *_, weight in views], positions)
    gaps = [np.hypot(x - views[0][0], y - views[0][1]) for x, y, _ in views]
    nearest = min((gap for gap in gaps if gap > 1e-6), default=None)
    assert fix is not None
    if nearest is None:
        assert fix.radius_m is None
    else:
        assert fix.radius_m is not None
        assert fix.radius_m >= nearest / len(views) * 0.999
