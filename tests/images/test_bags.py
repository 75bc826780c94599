"""Recordings of ROS 2 that are cut, damaged or odd: what can be read is listed, and nothing ends the reading."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import pytest

from tests.recorded_bags import bag, image, pose
from tests.sample_images import photo
from worker.images.apart import bag_child


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
