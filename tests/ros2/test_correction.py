"""Map to odom: against numbers worked by hand, and against matrices."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from revisit_ros.correction import Correction, map_to_odom
from revisit_ros.frames import FORWARD, Transform, level, quaternion_of_yaw, yaw_of
from revisit_ros.health import ERROR, OK, WARN, Report
from revisit_ros.pose import UNKNOWN, NoPose, Pose

from tests.ros2.test_frames import matrix

EAST, NORTH = 0.0, math.pi / 2


def pose(
    x: float,
    y: float,
    yaw: float | None,
    z: float = 0.0,
    spread: float = 8.0,
    height: float = 8.0,
    of_base: bool = True,
) -> Pose:
    return Pose((x, y, z), yaw, (spread, spread, height, UNKNOWN, UNKNOWN, 0.1), of_base)


def corrected(pose: Pose, base: Transform) -> Transform:
    found = map_to_odom(pose, base)
    assert isinstance(found, Transform)
    return found


def test_odometry_that_began_at_the_gate_facing_north() -> None:
    """Odometry has driven 3 m ahead and faces left; the map has the base at (10, 5), facing west. So odometry began at
    (10, 2), facing north: 3 m north of it is (10, 5), and left of north is west."""
    found = corrected(pose(10, 5, math.pi), level((3, 0, 0), NORTH))
    assert (found.x, found.y, found.z) == pytest.approx((10, 2, 0))
    assert yaw_of(found, FORWARD["x"]) == pytest.approx(NORTH)


def test_heights_count_where_the_map_has_them() -> None:
    up = level((0, 0, 0.4), EAST)
    assert corrected(pose(0, 0, EAST, z=3.0), up).z == pytest.approx(2.6)
    assert corrected(pose(0, 0, EAST, z=-1.2, height=UNKNOWN), up).z == 0


def test_a_robot_on_a_ramp_does_not_tilt_the_map() -> None:
    pitch = math.radians(-20) / 2
    ramp = Transform(3, 0, 0, 0, math.sin(pitch), 0, math.cos(pitch))
    found = corrected(pose(10, 5, EAST), ramp)
    assert (found.x, found.y, found.qx, found.qy, found.qz) == pytest.approx((7, 5, 0, 0, 0))


@pytest.mark.parametrize(
    ("known", "base", "detail"),
    [
        (pose(0, 0, None), level((0, 0, 0), EAST), "no heading"),
        (pose(0, 0, EAST, of_base=False), level((0, 0, 0), EAST), "base_frame is not known"),
        (pose(0, 0, EAST, spread=UNKNOWN), level((0, 0, 0), EAST), "how far off"),
        (pose(0, 0, EAST), Transform(0, 0, 0, 0, -math.sqrt(0.5), 0, math.sqrt(0.5)), "on end"),
    ],
)
def test_a_transform_leaves_nothing_open(known: Pose, base: Transform, detail: str) -> None:
    found = map_to_odom(known, base)
    assert isinstance(found, NoPose)
    assert detail in found.detail
    assert found.remedy


metres, angle = st.floats(-100, 100), st.floats(-math.pi, math.pi)


@given(metres, metres, metres, angle, metres, metres, metres, angle)
def test_by_it_the_base_is_where_it_was_recognised(
    x: float, y: float, z: float, yaw: float, odom_x: float, odom_y: float, odom_z: float, odom_yaw: float
) -> None:
    base = level((odom_x, odom_y, odom_z), odom_yaw)
    found = corrected(pose(x, y, yaw, z), base)
    assert matrix(found) @ matrix(base) == pytest.approx(matrix(level((x, y, z), yaw)), abs=1e-9)


@given(metres, metres, angle, metres, metres, angle, metres, metres, angle)
def test_what_odometry_drives_afterwards_the_base_drives_in_the_map(
    x: float, y: float, yaw: float, ox: float, oy: float, oyaw: float, dx: float, dy: float, turn: float
) -> None:
    before, step = level((ox, oy, 0.0), oyaw), level((dx, dy, 0.0), turn)
    found = corrected(pose(x, y, yaw), before)
    assert matrix(found.after(before.after(step))) == pytest.approx(
        matrix(level((x, y, 0.0), yaw)) @ matrix(step), abs=1e-6
    )


@given(metres, metres, angle, metres, metres, angle, st.floats(-1, 1), st.floats(-1, 1))
def test_it_is_level_however_the_base_is_tilted(
    x: float, y: float, yaw: float, ox: float, oy: float, oyaw: float, roll: float, pitch: float
) -> None:
    turned = Transform(ox, oy, 0, *quaternion_of_yaw(oyaw))
    tilted = turned.after(Transform(0, 0, 0, 0, math.sin(pitch / 2), 0, math.cos(pitch / 2)))
    tilted = tilted.after(Transform(0, 0, 0, math.sin(roll / 2), 0, 0, math.cos(roll / 2)))
    found, straight = corrected(pose(x, y, yaw), tilted), corrected(pose(x, y, yaw), turned)
    assert matrix(found)[2, :3] == pytest.approx(np.array([0, 0, 1]), abs=1e-9)
    assert matrix(found) == pytest.approx(matrix(straight), abs=1e-6)


def test_it_holds_until_the_next_one_or_so_long() -> None:
    one, other = level((1, 0, 0), EAST), level((2, 0, 0), EAST)
    for hold_s, later in ((0.0, other), (30.0, None)):
        correction = Correction(hold_s)
        assert correction.current(5.0) is None
        correction.take(one, 5.0)
        assert correction.current(5.0) == one
        correction.take(other, 6.0)
        assert correction.current(36.0) == other
        assert correction.current(36.1) == later
        correction.take(one, 40.0)
        assert correction.current(41.0) == one


def told(correction: Correction, now: float, level: int = OK, state: str = "working") -> Report:
    return correction.added_to(Report(level, "as before", {"state": state}), now)


def test_where_none_is_published_that_is_told() -> None:
    correction = Correction(30.0)
    assert (told(correction, 0).level, told(correction, 0).values["map_to_odom"]) == (WARN, "no match yet")
    assert "no match has given one yet" in told(correction, 0).message
    correction.take(level((0, 0, 0), EAST), 2.0)
    assert told(correction, 4.0) == Report(
        OK, "as before", {"state": "working", "map_to_odom": "published", "map_to_odom_age": "2.0"}
    )
    assert "older than transform_hold (30 s)" in told(correction, 33.0).message
    assert told(correction, 33.0).values["map_to_odom"] == "too old"
    correction.note = "no map to odom: no heading"
    assert told(correction, 4.0).message == "no map to odom: no heading"
    assert told(correction, 4.0, WARN).message == "as before; no map to odom: no heading"
    assert told(correction, 4.0).values["map_to_odom"] == "published"  # the one before holds on
    away = told(correction, 4.0, ERROR, "service away")
    assert (away.level, away.message, away.values["map_to_odom"]) == (ERROR, "as before", "published")
    correction.take(level((0, 0, 0), EAST), 5.0)
    assert told(correction, 5.0).level == OK
