"""Poses of TUM and KITTI as attributes of images: which way is up, which way the camera looks, which image is meant."""

import math
import unicodedata

import pytest
from hypothesis import given, strategies as st
from revisit_client import recordings

from worker.service.trajectories import (
    DEPTHS,
    LISTS,
    NAMES,
    Pose,
    is_list,
    is_trajectory,
    poses_of,
    read_list,
    read_poses,
)

LEVEL = "-0.7071068 0 0 0.7071068"
"""The camera's z turned from up to +y: looking north, upright."""


def tum(*lines: str) -> list[Pose]:
    return read_poses("groundtruth.txt", ("# time tx ty tz qx qy qz qw\n" + "\n".join(lines)).encode())


def test_a_camera_of_tum_that_looks_north() -> None:
    (pose,) = tum(f"1305031102.1753 1.5 2.5 0.5 {LEVEL}")

    assert (pose.x, pose.y, pose.z, pose.time) == (1.5, 2.5, 0.5, 1305031102.1753)
    assert pose.heading == pytest.approx(0, abs=1e-4) or pose.heading == pytest.approx(360, abs=1e-4)
    captured = pose.attributes().captured_at
    assert captured is not None
    assert captured.isoformat().startswith("2011-05-10T12:38:22.175")


@given(st.floats(1, 359))
def test_a_turn_about_the_vertical_turns_the_heading(degrees: float) -> None:
    half = math.radians(-degrees) / 2  # clockwise seen from above
    # The turn about z, times the quaternion that levels the camera.
    c, s, q = math.cos(half), math.sin(half), math.sqrt(0.5)
    (pose,) = tum(f"1 0 0 0 {-q * c} {-q * s} {q * s} {q * c}")

    assert pose.heading == pytest.approx(degrees, abs=1e-6)


def test_a_camera_that_looks_up_has_no_heading_and_small_times_are_no_date() -> None:
    (pose,) = tum("12.5 0 0 0 0 0 0 1")

    assert (pose.heading, pose.attributes().captured_at) == (None, None)


def test_a_camera_of_kitti_starts_looking_ahead_and_turns_right() -> None:
    ahead = "1 0 0 3 0 1 0 -1.5 0 0 1 40"
    right = "0 0 1 5 0 1 0 0 -1 0 0 41"

    first, second = read_poses("poses.txt", f"{ahead}\n{right}\n".encode())

    assert first == Pose(3, 40, 1.5, 0.0)
    assert second.heading == pytest.approx(90)


def test_images_get_the_pose_nearest_in_time() -> None:
    poses = tum(f"10.00 1 0 0 {LEVEL}", f"10.10 2 0 0 {LEVEL}", f"9.90 0 0 0 {LEVEL}")
    files = ["rgb/10.04.png", "rgb/10.06.png", "rgb/10.30.png", "rgb/a.png", "rgb/b.png"]

    found = poses_of(files, poses, {"rgb/a.png": 9.9, "b.png": 10.0})

    assert {file: pose.x for file, pose in found.items()} == {
        "rgb/10.04.png": 1,
        "rgb/10.06.png": 2,
        "rgb/a.png": 0,
        "rgb/b.png": 1,
    }


def test_poses_without_times_go_by_number_or_in_order() -> None:
    poses = [Pose(number, 0, 0, None) for number in range(3)]

    assert [pose.x for pose in poses_of(["000002.png", "000000.png"], poses, {}).values()] == [2, 0]
    assert [pose.x for pose in poses_of(["a.png", "b.png", "c.png"], poses, {}).values()] == [0, 1, 2]
    with pytest.raises(ValueError, match="3 poses without times do not belong to 2 images"):
        poses_of(["a.png", "b.png"], poses, {})
    with pytest.raises(ValueError, match="do not belong"):
        poses_of(["000007.png"], poses, {})


def test_numbers_of_frames_are_no_seconds() -> None:
    """Ten frames a second: as seconds, the frames 0 to 4 would lie where 0, 10, 20, 30 and 40 were taken."""
    poses = [Pose(number, 0, 0, None, number / 10) for number in range(50)]
    files = [f"{number:06}.png" for number in range(50)]

    with pytest.raises(ValueError, match=r"such as 000049.png, are no seconds of it \(0 to 4.9 s\); list the time"):
        poses_of(files, poses, {})

    listed = poses_of(files, poses, {file: number / 10 for number, file in enumerate(files)})
    assert [pose.x for pose in listed.values()] == list(range(50))
    seconds = poses_of(files[:5], poses, {})
    assert [pose.x for pose in seconds.values()] == [0, 10, 20, 30, 40]
    counted = [Pose(number, 0, 0, None, float(number)) for number in range(50)]
    assert [pose.x for pose in poses_of(files, counted, {}).values()] == list(range(50))


def test_other_images_beside_frames_make_no_seconds_of_their_numbers() -> None:
    """A plan among the frames, or the second camera's: frame 4 would lie where frame 40 was taken."""
    poses = [Pose(number, 0, 0, None, number / 10) for number in range(50)]
    files = [f"{number:06}.png" for number in range(50)]

    with pytest.raises(ValueError, match=r"such as 000049[.]png, are no seconds of it"):
        poses_of([*files, "plan.png"], poses, {})

    walked = [Pose(number, 0, 0, None, float(number)) for number in range(2000)]
    assert poses_of(["000012_10.png", "000013_10.png"], walked, {}) == {}  # not where 1210 s and 1310 s were taken


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "no pose"),
        ("# only a comment\n", "no pose"),
        ("1 2 3\n", "line 1: has 3 numbers"),
        (f"1 0 0 0 {LEVEL}\n1 0 0 3 0 1 0 0 0 0 1 4\n", "line 2: has 12 numbers, other than the first"),
        ("1 0 0 nan 0 0 0 1\n", "line 1: holds nan"),
        ("1 0 -1e300 0 0 0 0 1\n", "line 1: is further than 1e[+]09 metres from the origin"),
        ("1 0 0 0 0 1 0 0 0 0 1 1e10\n", "line 1: is further than 1e[+]09 metres from the origin"),
        ("1403636579763555584 0 0 0 0 0 0 1\n", "line 1: its time is .* s, beyond the year 9999"),
        ("1 0 0 north 0 0 0 1\n", "line 1: holds something that is no number"),
        ("1 0 0 0 0 0 0 0\n", "quaternion is 0"),
    ],
)
def test_a_line_that_cannot_be_used_is_named(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        read_poses("poses.txt", text.encode())


def test_lists_of_images() -> None:
    assert read_list("rgb.txt", b"# time file\n1.5 rgb/1.5.png\n2 ./rgb/2.png\n") == {
        "rgb/1.5.png": 1.5,
        "rgb/2.png": 2,
    }
    apart = unicodedata.normalize("NFD", "rgb/höhe.png")  # as macOS writes it
    assert poses_of([apart], tum(f"7 4 0 0 {LEVEL}"), read_list("rgb.txt", "7 rgb/höhe.png".encode()))[apart].x == 4
    for time in (b"soon", b"nan"):
        with pytest.raises(ValueError, match="line 1: needs a time and a file"):
            read_list("rgb.txt", time + b" rgb/1.png")
    with pytest.raises(ValueError, match=r"line 2: 1[.]png has two times, 1 and 2 s"):
        read_list("rgb.txt", b"1 1.png\n2 1.png\n")
    read_list("images.txt", b"1 0.9 0.1 0 0 1 2 3 1 a.jpg\n2 0.9 0.1 0 0 1 2 3 1 b.jpg\n")  # COLMAP's, of no use here
    with pytest.raises(ValueError, match="no text"):
        read_list("rgb.txt", b"\xff\xfe\x00")


def test_what_the_client_sends_of_a_folder_is_what_is_read() -> None:
    assert recordings.TRAJECTORIES == NAMES | LISTS | DEPTHS


def test_they_are_known_by_their_names() -> None:
    assert all(map(is_trajectory, ("groundtruth.txt", "a/poses.txt", "CameraTrajectory.txt", "walk.TUM")))
    assert not any(map(is_trajectory, ("notes.txt", "rgb.txt", "poses.csv")))
    assert is_list("seq/rgb.txt")
