"""Axes and angles, against numbers worked by hand, and against matrices."""

import math

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, strategies as st
from revisit_ros.frames import (
    FORWARD,
    Transform,
    base_of_camera,
    heading_of_yaw,
    quaternion_of_yaw,
    yaw_of,
    yaw_of_heading,
)

from tests.ros2.fake_tf2 import as_matrix, as_message

OPTICAL = (-0.5, 0.5, -0.5, 0.5)
"""An optical frame in a body frame (REP 103): z forward, x to the right, y down."""


@pytest.mark.parametrize(
    ("heading", "yaw"),
    [(0, math.pi / 2), (90, 0), (180, -math.pi / 2), (270, math.pi), (45, math.pi / 4), (135, -math.pi / 4)],
)
def test_north_is_plus_y_and_yaw_counts_from_plus_x(heading: float, yaw: float) -> None:
    assert yaw_of_heading(heading) == pytest.approx(yaw)
    assert heading_of_yaw(yaw) == pytest.approx(heading)


@given(st.floats(-1e4, 1e4))
def test_headings_of_yaws_are_what_the_service_takes(yaw: float) -> None:
    heading = heading_of_yaw(yaw)
    assert 0 <= heading < 360
    assert -math.pi < yaw_of_heading(heading) <= math.pi
    assert math.cos(yaw_of_heading(heading) - yaw) == pytest.approx(1, abs=1e-6)


def test_a_tiny_turn_past_north_is_not_360() -> None:
    assert heading_of_yaw(math.pi / 2 + 1e-17) == 0
    assert heading_of_yaw(math.nextafter(math.pi / 2, 2)) < 360


def test_a_quarter_turn_about_each_axis() -> None:
    half = math.sqrt(0.5)
    assert Transform(0, 0, 0, 0, 0, half, half).rotated((1, 0, 0)) == pytest.approx((0, 1, 0))
    assert Transform(0, 0, 0, half, 0, 0, half).rotated((0, 1, 0)) == pytest.approx((0, 0, 1))
    assert Transform(0, 0, 0, 0, half, 0, half).rotated((0, 0, 1)) == pytest.approx((1, 0, 0))


def test_an_optical_frame_looks_along_the_body() -> None:
    camera = Transform(0, 0, 0, *OPTICAL)
    assert camera.rotated(FORWARD["z"]) == pytest.approx((1, 0, 0))
    assert camera.rotated((1, 0, 0)) == pytest.approx((0, -1, 0))
    assert camera.rotated((0, 1, 0)) == pytest.approx((0, 0, -1))
    assert yaw_of(camera, FORWARD["z"]) == pytest.approx(0)
    assert yaw_of(Transform(0, 0, 0), FORWARD["x"]) == pytest.approx(0)


def test_a_camera_that_looks_up_or_down_has_no_heading() -> None:
    def tilted(degrees: float) -> Transform:
        angle = math.radians(degrees) / 2
        return Transform(0, 0, 0, 0, math.sin(angle), 0, math.cos(angle))

    assert yaw_of(tilted(90), FORWARD["x"]) is None
    assert yaw_of(tilted(-80), FORWARD["x"]) is None
    assert yaw_of(tilted(70), FORWARD["x"]) == pytest.approx(0)
    assert yaw_of(Transform(1, 2, 3), FORWARD["z"]) is None  # an optical frame that is none


unit = st.floats(-1, 1)


@given(unit, unit, unit, unit, st.tuples(unit, unit, unit))
def test_rotations_are_those_of_matrices(
    x: float, y: float, z: float, w: float, vector: tuple[float, float, float]
) -> None:
    if math.hypot(x, y, z, w) < 0.1:
        return
    ours = Transform(0, 0, 0, x, y, z, w)
    placed = np.eye(4)
    placed[:3, 3] = vector
    unit_length = np.array([x, y, z, w]) / math.hypot(x, y, z, w)
    told = as_message(placed, "a", "b")
    for axis, value in zip("xyzw", unit_length, strict=True):
        setattr(told.transform.rotation, axis, float(value))
    assert ours.rotated(vector) == pytest.approx(as_matrix(told)[:3, :3] @ np.array(vector), abs=1e-9)


number = st.floats(-100, 100)
rotation = st.tuples(unit, unit, unit, unit).filter(lambda q: math.hypot(*q) > 0.1)
transform = st.builds(lambda x, y, z, q: Transform(x, y, z, *q), number, number, number, rotation)


def matrix(placed: Transform) -> npt.NDArray[np.float64]:
    told = as_message(np.eye(4), "a", "b")
    for name in "xyz":
        setattr(told.transform.translation, name, getattr(placed, name))
    for name in "xyzw":
        setattr(told.transform.rotation, name, getattr(placed, f"q{name}"))
    return as_matrix(told)


@given(transform, transform)
def test_transforms_one_after_the_other_are_products_of_matrices(outer: Transform, inner: Transform) -> None:
    assert matrix(outer.after(inner)) == pytest.approx(matrix(outer) @ matrix(inner), abs=1e-9)


@given(transform)
def test_there_and_back_is_where_one_was(placed: Transform) -> None:
    assert matrix(placed.inverse()) == pytest.approx(np.linalg.inv(matrix(placed)), abs=1e-9)
    for both in (placed.after(placed.inverse()), placed.inverse().after(placed)):
        assert matrix(both) == pytest.approx(np.eye(4), abs=1e-9)


@given(transform, transform, transform)
def test_it_does_not_matter_which_two_are_joined_first(a: Transform, b: Transform, c: Transform) -> None:
    assert matrix(a.after(b).after(c)) == pytest.approx(matrix(a.after(b.after(c))), abs=1e-9)


@pytest.mark.parametrize(
    "numbers",
    [(0, 0, 0, 0, 0, 0, 0), (math.nan, 0, 0, 0, 0, 0, 1), (0, math.inf, 0, 0, 0, 0, 1), (0, 0, 0, math.nan, 0, 0, 1)],
)
def test_what_is_no_transform_is_refused(numbers: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="no transform"):
        Transform(*numbers)


def test_a_quaternion_of_any_length_is_taken() -> None:
    assert Transform(0, 0, 0, 0, 0, 3, 3).rotated((1, 0, 0)) == pytest.approx((0, 1, 0))


def test_the_base_stands_behind_its_camera() -> None:
    """The camera sits 0.3 m ahead and 1.2 m up and looks ahead; it is at (10, 5, 1.2) and looks north."""
    mount = Transform(0.3, 0, 1.2, *OPTICAL)
    position, yaw = base_of_camera((10, 5, 1.2), math.pi / 2, mount, 0.0)
    assert position == pytest.approx((10, 4.7, 0))
    assert yaw == pytest.approx(math.pi / 2)


def test_the_base_of_a_camera_that_looks_left() -> None:
    """It sits 0.2 m to the left and looks left, and sees north: the robot faces east."""
    position, yaw = base_of_camera((0, 0, 0), math.pi / 2, Transform(0, 0.2, 0.5), math.pi / 2)
    assert yaw == pytest.approx(0)
    assert position == pytest.approx((0, -0.2, -0.5))


@given(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3, 3), st.floats(-3, 3), st.floats(-1, 1), st.floats(-1, 1))
def test_a_camera_that_is_carried_along_is_where_its_base_says(
    x: float, y: float, robot: float, turned: float, ahead: float, left: float
) -> None:
    """There and back: base to camera by matrices, camera to base by ours."""
    base, mount = np.eye(4), np.eye(4)
    for placed, yaw, where in ((base, robot, (x, y, 0.0)), (mount, turned, (ahead, left, 0.7))):
        placed[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
        placed[:3, 3] = where
    camera = base @ mount
    seen = Transform(*camera[:3, 3].tolist(), *quaternion_of_yaw(robot + turned))  # type: ignore[call-arg]
    own = Transform(ahead, left, 0.7, *quaternion_of_yaw(turned))
    looks, sits = yaw_of(seen, FORWARD["x"]), yaw_of(own, FORWARD["x"])
    assert looks is not None
    assert sits is not None
    position, yaw = base_of_camera((seen.x, seen.y, seen.z), looks, own, sits)
    assert position == pytest.approx((x, y, 0), abs=1e-9)
    assert math.cos(yaw - robot) == pytest.approx(1, abs=1e-9)
