"""From answers to poses, covariances and landmarks, against numbers worked by hand."""

import math
from typing import Any

import pytest
from hypothesis import given, strategies as st
from revisit_client.wire import QueryAnswer, View
from revisit_ros.frames import FORWARD, Transform
from revisit_ros.landmarks import Landmarks, name_of, number_of
from revisit_ros.pose import UNKNOWN, NoPose, Pose, guess_of, pose_of

from app.http.examples import QUERY_ANSWER
from tests.answers import view

MOUNT = Transform(0.3, 0.0, 1.2, -0.5, 0.5, -0.5, 0.5)
"""An optical frame 0.3 m ahead of the base and 1.2 m above it, which looks ahead."""

TURN = math.radians(20) ** 2


def position(**given: float) -> dict[str, float | None]:
    return dict.fromkeys(("x", "y", "z", "lat", "lon", "alt", "heading")) | given


def answered(
    status: str = "matched", radius: float | None = 4.0, heading: float | None = 0.0, **where: float
) -> QueryAnswer:
    """An answer whose estimate is at `where`, and whose first match faces `heading`."""
    first = dict(QUERY_ANSWER["matches"][0])
    faced = {} if heading is None else {"heading": heading}
    first["view"] = view(position=position(**(where or {"x": 1.0, "y": 2.0}), **faced))
    estimate: dict[str, Any] | None = (
        {"position": position(**where), "radius_m": radius, "views": []} if where else None
    )
    return QueryAnswer.model_validate({**QUERY_ANSWER, "status": status, "matches": [first], "estimate": estimate})


def posed(answer: QueryAnswer, mount: Transform | None = MOUNT, **options: Any) -> Pose:
    pose = pose_of(answer, mount, FORWARD["z"], **options)
    assert isinstance(pose, Pose)
    return pose


def test_a_camera_that_looks_north() -> None:
    """Camera at (10, 5, 1.2); the base is 0.3 m south of it, on the ground, and faces north."""
    pose = posed(answered(x=10.0, y=5.0, z=1.2))
    assert pose.position == pytest.approx((10, 4.7, 0))
    assert pose.yaw == pytest.approx(math.pi / 2)
    assert pose.variances == pytest.approx((8, 8, 8, UNKNOWN, UNKNOWN, TURN))  # 4 m in both axes together
    assert (pose.of_base, pose.note) == (True, "")


def test_the_covariance_is_row_by_row_as_ros_orders_it() -> None:
    covariance = posed(answered(x=0.0, y=0.0)).covariance()
    assert len(covariance) == 36
    assert [covariance[7 * axis] for axis in range(6)] == pytest.approx([8, 8, UNKNOWN, UNKNOWN, UNKNOWN, TURN])
    assert sum(map(bool, covariance)) == 6
    assert all(type(number) is float for number in covariance)


def test_without_a_height_it_is_on_the_ground_and_nobody_knows_which() -> None:
    pose = posed(answered(x=1.0, y=2.0))
    assert pose.position[2] == pytest.approx(-1.2)
    assert pose.variances[2] == UNKNOWN


def test_without_a_heading_the_base_is_anywhere_around_the_camera() -> None:
    """0.3 m on a side that nobody knows: 0.09 / 2 m^2 more along each axis."""
    pose = posed(answered(heading=None, x=1.0, y=2.0, z=1.2))
    assert pose.position == pytest.approx((1, 2, 0))
    assert pose.yaw is None
    assert pose.variances == pytest.approx((8.045, 8.045, 8.045, UNKNOWN, UNKNOWN, UNKNOWN))
    assert "heading" in pose.note


def test_without_a_radius_the_position_is_given_and_said_to_be_of_unknown_worth() -> None:
    pose = posed(answered(radius=None, x=1.0, y=2.0))
    assert pose.position[:2] == pytest.approx((1, 1.7))
    assert pose.variances[:2] == (UNKNOWN, UNKNOWN)
    assert "how far off" in pose.note
    assert posed(answered(radius=None, heading=None, x=1.0, y=2.0)).variances[:2] == (UNKNOWN, UNKNOWN)


def test_without_a_mount_the_pose_is_the_cameras_and_says_so() -> None:
    pose = posed(answered(x=1.0, y=2.0), None)
    assert (pose.position, pose.of_base) == ((1, 2, 0), False)
    assert pose.yaw == pytest.approx(math.pi / 2)
    assert "camera's" in pose.note
    assert posed(answered(x=1.0, y=2.0), None, base_wanted=False).note == ""


def test_a_camera_that_looks_at_the_ceiling_tells_no_yaw() -> None:
    up = Transform(0.0, 0.0, 1.0)  # its z points up
    pose = posed(answered(x=1.0, y=2.0), up)
    assert (pose.yaw, pose.variances[5]) == (None, UNKNOWN)
    assert "up or down" in pose.note


@pytest.mark.parametrize("status", ["ambiguous", "no_match"])
def test_only_what_matched_has_a_pose(status: str) -> None:
    none = pose_of(answered(status, x=1.0, y=2.0), MOUNT, FORWARD["z"])
    assert isinstance(none, NoPose)
    assert none.detail.startswith(status)


def test_views_without_positions_or_with_degrees_have_none() -> None:
    nowhere, globe = (
        pose_of(answer, MOUNT, FORWARD["z"]) for answer in (answered(), answered(lat=50.0, lon=14.0, radius=5.0))
    )
    assert isinstance(nowhere, NoPose)
    assert isinstance(globe, NoPose)
    assert "no position" in nowhere.detail
    assert "degrees" in globe.detail


def covariance(xx: float, xy: float, yy: float) -> list[float]:
    made = [0.0] * 36
    made[0], made[1], made[6], made[7] = xx, xy, xy, yy
    return made


def test_a_guess_searches_three_standard_deviations_of_its_longer_axis() -> None:
    assert guess_of(1, 2, covariance(100, 0, 4)).radius_m == pytest.approx(30)
    # Along the diagonal: variance 64 + 36 = 100.
    assert guess_of(1, 2, covariance(64, 36, 64)).radius_m == pytest.approx(30)
    assert guess_of(1, 2, covariance(0, 0, 0)).radius_m == 20


@pytest.mark.parametrize(("place", "value"), [(0, math.nan), (7, -1.0), (0, math.inf), (35, math.nan)])
def test_a_guess_that_is_none_is_refused(place: int, value: float) -> None:
    made = covariance(1, 0, 1)
    made[place] = value
    with pytest.raises(ValueError, match="its"):
        guess_of(0, 0, made)
    with pytest.raises(ValueError, match="finite"):
        guess_of(math.nan, 0, covariance(1, 0, 1))


@given(st.text(max_size=40))
def test_numbers_of_landmarks_fit_and_stay(name: str) -> None:
    if any("\ud800" <= letter <= "\udfff" for letter in name):
        return
    assert 1 <= number_of(name) == number_of(name) <= 2**31 - 1


def test_a_number_is_the_same_in_every_run() -> None:
    """RTAB-Map's database keeps it: it may never change."""
    assert number_of("campus/entrance") == 610107226


def test_a_place_is_one_landmark_and_a_view_without_one_is_its_own() -> None:
    one, other = (View.model_validate(view(place=place)) for place in ("gate", None))
    assert name_of(one) == f"{one.map}/gate"
    assert name_of(other) == other.id


def test_a_match_is_the_landmark_that_the_enrolment_was() -> None:
    landmarks = Landmarks(5.0)
    matched = answered(x=1.0, y=2.0)
    enrolled, seen = landmarks.enrolled(matched.matches[0].view), landmarks.recognised(matched)
    assert enrolled is not None
    assert seen is not None
    assert enrolled.id == seen.id
    assert seen.variance == pytest.approx(8)
    assert [seen.covariance()[7 * axis] for axis in range(6)] == pytest.approx([8, 8, 8, UNKNOWN, UNKNOWN, UNKNOWN])
    assert enrolled.variance == pytest.approx(12.5)  # one of perhaps several views of a place: 5 m
    alone = landmarks.enrolled(View.model_validate(view(place=None)))
    assert alone is not None
    assert alone.variance == pytest.approx(0.15**2 / 2)
    without = landmarks.recognised(answered(radius=None, x=1.0, y=2.0))
    assert without is not None
    assert without.variance == pytest.approx(12.5)
    assert landmarks.recognised(answered("ambiguous", x=1.0, y=2.0)) is None


def test_two_names_of_one_number_are_never_one_landmark(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("revisit_ros.landmarks.number_of", lambda name: 7)
    landmarks = Landmarks(5.0)
    first, second = (View.model_validate(view(place=place)) for place in ("gate", "quay"))
    assert landmarks.enrolled(first) is not None
    assert landmarks.enrolled(second) is None
    assert landmarks.enrolled(first) is not None
