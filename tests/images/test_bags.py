"""Recordings of ROS 2 that are cut, damaged or odd: what can be read is listed, and nothing ends the reading."""

import math
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import pytest

from schemas.errors import BadBody
from tests.recorded_bags import at as standing, bag, fix, image, odometry, pose
from tests.sample_images import photo
from worker.images.apart import bag_child
from worker.images.apart.bag import Bag
from worker.images.codec import Limits
from worker.service.bags import recording_of


def listed(path: Path, data: bytes) -> dict[str, Any]:
    decoder = pytest.importorskip("mcap_ros2.decoder", reason="NO MCAP FILE IS READ: the extra `mcap` is not installed")
    path.write_bytes(data)
    return bag_child._listed(path, decoder.DecoderFactory())


@pytest.mark.parametrize("compression", ["ZSTD", "LZ4", "NONE"])
def test_wherever_a_recording_is_cut_or_damaged_what_comes_before_is_listed(tmp_path: Path, compression: str) -> None:
    whole = bag([image(n, photo(n)) for n in range(2)], compression)
    cuts = range(8, len(whole), 41)
    counts = []
    for at in cuts:
        counts.append(sum(map(len, listed(tmp_path / "upload", whole[:at])["images"].values())))
        for damage in (bytes(40), b"\xff" * 8):
            known = listed(tmp_path / "upload", whole[:at] + damage + whole[at + len(damage) :])
            assert sum(map(len, known["images"].values())) <= 2
    assert (counts, counts[0], counts[-1]) == (sorted(counts), 0, 2)


def test_a_pose_whose_fields_have_other_names_is_no_pose(tmp_path: Path) -> None:
    other = bag([image(0, photo()), pose(0, 1, 2)], "NONE").replace(
        b"Quaternion orientation", b"Quaternion orientatiom"
    )
    known = listed(tmp_path / "upload", other)
    assert (len(known["images"]["/camera/compressed"]), known["poses"]) == (1, {"/pose": []})


def test_a_frame_without_pixels_does_not_end_the_reading() -> None:
    empty = SimpleNamespace(encoding="rgb8", width=0, height=0, step=0, data=b"")
    assert bag_child._usable(cv2, empty, 1000, 1000) is None


def test_what_cannot_be_a_pose_is_none(tmp_path: Path) -> None:
    """A filter that has diverged, and a receiver that writes what is no point on the earth."""
    unturned = SimpleNamespace(
        position=standing(3, 4).position, orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0)
    )
    longer = SimpleNamespace(position=standing(5, 6).position, orientation=SimpleNamespace(x=0.0, y=0.0, z=2.0, w=2.0))
    poses = [pose(0, 1e300, 0), pose(1, 0, -2e9), pose(2, 1, 2)]
    poses += [("/pose", "geometry_msgs/msg/PoseStamped", n, {"pose": one}) for n, one in ((3, unturned), (4, longer))]
    fixes = [fix(0, 91.0, 0.0), fix(1, 0.0, -180.5), fix(2, math.nan, 0.0), fix(3, 50.0, 14.0)]

    known = listed(tmp_path / "upload", bag([image(0, photo()), *poses, *fixes]))["poses"]

    assert [row[1:] for row in known["/pose"]] == [
        [1, 2, 0, 90],
        [3, 4, 0, None],  # no heading was told
        [5, 6, 0, pytest.approx(0, abs=1e-9)],  # a quarter turn to the left of x, which is +y
    ]
    assert [row[1:] for row in known["/fix"]] == [[50, 14, 12, None]]


def test_a_topic_of_two_types_has_the_poses_of_the_first(tmp_path: Path) -> None:
    told = {"data": "hello"}
    for other in (fix(3, 50.0, 14.0), ("/fix", "std_msgs/msg/String", 3.0, told), image(3, photo(1))):
        path, messages = tmp_path / "upload", [image(0, photo()), pose(0, 1, 2), ("/posf", *other[1:])]
        known = listed(path, bag(messages, "NONE").replace(b"/posf", b"/pose"))
        assert (known["types"]["/pose"], len(known["poses"]["/pose"])) == ("geometry_msgs/msg/PoseStamped", 1)
        with closing(Bag(path, Limits(), "/camera/compressed", None)) as one:
            assert [row[1:3] for row in one.poses] == [[1, 2]]


def test_where_a_robot_is_to_go_is_not_where_it_was(tmp_path: Path) -> None:
    """`ros2 bag record -a` records the goals of RViz beside odometry."""
    path = tmp_path / "upload"
    path.write_bytes(bag([image(1, photo()), odometry(0.5, 1, 0), odometry(1.5, 2, 0), pose(1, 500, 0, "/goal_pose")]))
    with closing(recording_of(Bag(path, Limits(), None, None))) as recording:
        assert recording.items[0].attributes.position.x == 1.5
    with closing(recording_of(Bag(path, Limits(), None, "/goal_pose"))) as recording:
        assert recording.items[0].attributes.position.x == 500
    path.write_bytes(bag([image(1, photo()), pose(1, 500, 0, "/robot/initialpose")]))
    with closing(recording_of(Bag(path, Limits(), None, None))) as recording:
        assert recording.items[0].attributes.position.x is None


def test_a_topic_without_a_pose_that_can_be_used_is_not_chosen_and_is_told_of(tmp_path: Path) -> None:
    path = tmp_path / "upload"
    lost = pose(1, 1e300, 0)
    path.write_bytes(bag([image(1, photo()), lost, odometry(1, 7, 0)]))
    with closing(recording_of(Bag(path, Limits(), None, None))) as recording:
        assert recording.items[0].attributes.position.x == 7
    path.write_bytes(bag([image(1, photo()), fix(1, 50.0, 14.0, status=-1)]))
    with closing(recording_of(Bag(path, Limits(), None, None))) as recording:
        assert [note.detail for note in recording.notes] == ["no pose lies within 0.2 s of it; it has no position"]


def test_a_topic_without_end_is_passed_over(tmp_path: Path) -> None:
    """Of a megabyte, say, which packs to nothing: as the name of 50,000 images it would fill the memory."""
    known = listed(tmp_path / "upload", bag([image(0, photo(), "/" + "a" * 300), image(0, photo(), "/front")]))
    assert [*known["images"]] == [*known["types"]] == ["/front"]


def test_encodings_that_are_not_read_are_named(tmp_path: Path) -> None:
    raw = {"height": 32, "width": 32, "is_bigendian": 0, "step": 96, "data": bytes(32 * 96)}
    kind = "sensor_msgs/msg/Image"
    read, unread = (("/raw", kind, 0.0, {**raw, "encoding": encoding}) for encoding in ("rgb8", "bayer_rggb8"))
    path = tmp_path / "upload"
    path.write_bytes(bag([unread, unread]))
    with pytest.raises(BadBody, match=r"no image of /raw has an encoding that is read, rgb8, .*; it has 2 bayer_rggb8"):
        Bag(path, Limits(), None, None)
    path.write_bytes(bag([read, unread]))
    with closing(recording_of(Bag(path, Limits(), None, None))) as recording:
        assert [(note.file, note.problem) for note in recording.notes] == [("/raw", "undecodable-picture")]
        assert "1 bayer_rggb8; rgb8" in recording.notes[0].detail
        assert len(recording.items) == 2
