"""A recording of ROS 2 is sent as it is: its images are enrolled with where they were taken, by its poses."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from schemas.errors import BadBody, BodyTooLarge
from schemas.imports import ImportOptions
from schemas.records import Position
from tests.recorded_bags import START, bag, fix, image, odometry, pose
from tests.sample_images import drawn, photo
from tests.stories.importing import ended, is_emptied
from tests.stories.running import RunningService
from worker.images.apart import bag as reading, bag_child
from worker.images.codec import Limits
from worker.service import opening, recordings
from worker.service.bags import position_at

pytestmark = pytest.mark.one_database("it is about what a recording says; archives are imported into both")

MCAP = {"content-type": "application/x-mcap"}


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    with RunningService(tmp_path_factory.mktemp("bags")) as one:
        yield one


@pytest.fixture
def client(service: RunningService) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=service.url, timeout=60) as one:
        yield one


def sent(client: httpx.Client, name: str, body: bytes, **params: str) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The result of an import, and the views of its map."""
    answer = client.post(f"/maps/{name}/imports", params=params, content=body, headers=MCAP)
    assert answer.status_code == 202, answer.text
    job = ended(client, answer.json()["id"])
    assert job["state"] == "done", job
    return job["result"], client.get("/views", params={"map": name}).json()["views"]


def refusal(client: httpx.Client, body: bytes, **params: str) -> str:
    """Why an import is refused."""
    answer = client.post("/maps/none/imports", params=params, content=body, headers=MCAP)
    assert answer.status_code == 400, answer.text
    assert client.get("/maps/none").status_code == 404
    return str(answer.json()["detail"])


@pytest.mark.parametrize("compression", ["ZSTD", "LZ4", "NONE"])
def test_images_are_enrolled_between_the_poses_before_and_after(client: httpx.Client, compression: str) -> None:
    walk = [odometry(0.5 * n, n, 2 * n) for n in range(9)]
    body = bag([*walk, *(image(n + 0.25, photo(n)) for n in range(4)), image(60, photo(9))], compression)

    result, views = sent(client, f"walk-{compression}", body)

    assert (result["enrolled"], result["failed"]) == (5, 0)
    assert [error["file"] for error in result["errors"]] == [f"/camera/compressed {START + 60:.3f}"]
    assert [view["position"]["x"] for view in views[:4]] == pytest.approx([0.5, 2.5, 4.5, 6.5])
    assert [view["position"]["y"] for view in views[:4]] == pytest.approx([1, 5, 9, 13])
    assert {view["position"]["heading"] for view in views[:4]} == {90}  # x ahead is east
    assert views[4]["position"] is None
    assert views[0]["captured_at"] == "2026-01-01T00:00:00.250000Z"
    assert client.get(f"/views/{views[2]['id']}/image").content == photo(2)  # as it was recorded


def test_a_view_a_metre_of_what_the_robot_drove(client: httpx.Client) -> None:
    messages = [odometry(0.1 * n, 0.1 * n, 0) for n in range(31)] + [image(0.1 * n, photo(n)) for n in range(31)]
    result, views = sent(client, "metres", bag(messages), every="1m")
    assert [view["position"]["x"] for view in views] == pytest.approx([0, 1, 2, 3])
    assert (result["images"], result["left_out"]) == (4, 27)


def test_of_several_topics_the_caller_chooses(client: httpx.Client) -> None:
    messages = [image(n, photo(n), "/front") for n in range(3)] + [image(n, photo(n + 3), "/rear") for n in range(3)]
    messages += [pose(n, n, 0, "/amcl") for n in range(3)] + [pose(n, 100 + n, 0, "/slam") for n in range(3)]
    messages += [odometry(n, 50 + n, 0) for n in range(3)]
    body = bag(messages)
    assert "say image_topic= one of /front, /rear" in refusal(client, body)
    assert "no such topic as '/left'" in refusal(client, body, image_topic="/left")
    assert "say pose_topic= one of /amcl, /slam" in refusal(client, body, image_topic="/rear")
    assert "no such topic as '/map'" in refusal(client, body, image_topic="/rear", pose_topic="/map")

    _, views = sent(client, "chosen", body, image_topic="/rear", pose_topic="/slam")
    assert [view["position"]["x"] for view in views] == [100, 101, 102]
    _, views = sent(client, "driven", body, image_topic="/front", pose_topic="/odom")
    assert [view["position"]["x"] for view in views] == [50, 51, 52]


def test_a_receiver_of_satellites_says_where(client: httpx.Client) -> None:
    messages = [fix(0, 52.0, 13.0), fix(1, 52.0002, 13.0004), fix(2, 0, 0, status=-1), image(0.5, photo(1))]
    _, [view] = sent(client, "outside", bag(messages))
    assert (view["position"]["lat"], view["position"]["lon"]) == pytest.approx((52.0001, 13.0002))


def test_images_without_compression_are_kept_as_jpeg(client: httpx.Client) -> None:
    pixels = drawn(64, 48, 3)
    padded = np.zeros((48, 200), np.uint8)
    padded[:, :192] = pixels.reshape(48, 192)
    raw = {"height": 48, "width": 64, "encoding": "rgb8", "is_bigendian": 0, "step": 200, "data": padded.tobytes()}
    kind = "sensor_msgs/msg/Image"
    messages = [("/raw", kind, 0.0, raw), ("/raw", kind, 1.0, {**raw, "encoding": "bayer_rggb8"})]
    messages += [("/raw", kind, 2.0, {**raw, "height": 4_000_000_000})]

    result, [view] = sent(client, "raw", bag(messages))

    assert (result["enrolled"], result["failed"]) == (1, 2)
    found = client.post("/query?map=raw", content=photo(3, "png"), headers={"content-type": "image/png"}).json()
    assert found["matches"][0]["view"]["id"] == view["id"]
    assert (view["image"]["width"], view["image"]["height"]) == (64, 48)


def test_of_a_recorder_that_was_killed_what_it_wrote_is_read(client: httpx.Client) -> None:
    whole = bag([image(n, photo(n)) for n in range(40)])
    result, views = sent(client, "cut", whole[: len(whole) * 6 // 10])
    assert 10 < result["enrolled"] == len(views) < 40
    [broken] = result["errors"]
    assert "breaks off after" in broken["detail"]


def test_what_holds_no_image_says_what_it_holds(client: httpx.Client) -> None:
    text = ("/chatter", "std_msgs/msg/String", 0.0, {"data": "hello"})
    assert "/chatter (std_msgs/msg/String)" in refusal(client, bag([text]))
    assert "it holds no images" in refusal(client, b"\x89MCAP0\r\n" + bytes(1000))


def test_a_damaged_file_costs_no_more_than_itself(client: httpx.Client, service: RunningService) -> None:
    whole = bag([image(n, photo(n)) for n in range(12)])
    random = np.random.default_rng(1)
    for _ in range(12):
        damaged = bytearray(whole)
        for at in random.integers(8, len(whole), 20):
            damaged[at] ^= 0xFF
        answer = client.post("/maps/damaged/imports", content=bytes(damaged), headers=MCAP)
        assert answer.status_code in (202, 400), answer.text
        if answer.status_code == 202:
            assert ended(client, answer.json()["id"])["state"] == "done"
    assert client.get("/readyz").status_code == 200
    assert is_emptied(service.data / "imports")


def test_positions_are_not_made_up() -> None:
    poses: list[list[float | None]] = [[0, 0, 0, None, 10], [1, 2, 4, 5, 20], [10, 9, 9, 9, 30]]
    assert position_at(poses, 0.4, geographic=False) == Position(x=0.8, y=1.6, z=None, heading=10)
    assert position_at(poses, 0.6, geographic=False) == Position(x=1.2, y=2.4, z=None, heading=20)
    assert position_at(poses, 1.1, geographic=False) == Position(x=2, y=4, z=5, heading=20)
    assert position_at(poses, 5, geographic=False) is None
    assert position_at(poses, 11, geographic=False) is None
    assert position_at([], 0, geographic=False) is None


@pytest.mark.parametrize("side", [1, -1])
def test_a_way_across_the_date_line_does_not_lead_round_the_globe(side: int) -> None:
    across: list[list[float | None]] = [[0, 10, side * 179.75, 3, None], [1, 12, side * -179.75, 3, None]]
    for time, lat, lon in ((0.25, 10.5, 179.875), (0.5, 11, 180), (0.75, 11.5, -179.875)):
        assert position_at(across, time, geographic=True) == Position(lat=lat, lon=side * lon, alt=3)
    level: list[list[float | None]] = [[0, 0, side * 200, 3, None], [1, 0, side * -200, 3, None]]
    assert position_at(level, 0.25, geographic=False) == Position(x=0, y=side * 100, z=3)


def test_a_listing_ends_before_it_fills_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decoder = pytest.importorskip("mcap_ros2.decoder", reason="NO MCAP FILE IS READ: the extra `mcap` is not installed")
    (path := tmp_path / "upload").write_bytes(
        bag([image(n, photo(n)) for n in range(6)] + [pose(n, n, 0, f"/pose{n}") for n in range(6)])
    )
    monkeypatch.setattr(bag_child, "MOST_LISTED", 8)
    monkeypatch.setattr(bag_child, "MOST_TOPICS", 3)
    known = bag_child._listed(path, decoder.DecoderFactory())
    assert (len(known["types"]), len(known["poses"]), known["broken"]) == (3, 2, None)

    monkeypatch.setattr(bag_child, "MOST_LISTED", 4)
    known = bag_child._listed(path, decoder.DecoderFactory())
    assert (len(known["images"]["/camera/compressed"]), known["broken"]) == (4, "it has more than 4 images and poses")


def test_a_service_without_the_packages_says_which(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "find_spec", lambda _: None)
    with pytest.raises(BadBody, match="pip install mcap mcap-ros2-support"):
        reading.Bag(tmp_path / "upload", Limits(), None, None)


def test_only_images_that_are_wanted_count_against_the_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (path := tmp_path / "upload").write_bytes(bag([image(n, photo(n)) for n in range(10)]))
    monkeypatch.setattr(opening, "MOST_FILES", 5)
    limits = recordings.Limits(Limits(), 1_000_000, 20)
    with opening.open_recording(path, limits, ImportOptions(every_s=3)) as recording:
        assert [item.read() for item in recording.items] == [photo(n) for n in (0, 3, 6, 9)]
    with pytest.raises(BodyTooLarge, match="10 images that are wanted; at most 5"):
        opening.open_recording(path, limits, ImportOptions())
