"""A video is sent: a frame every so often is enrolled, whatever happens meanwhile; so are images far enough apart."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import httpx
import psutil
import pytest

from tests.drawn_videos import frames, video
from tests.sample_images import encoded
from tests.stories.importing import ZIP, ended, photos, zipped
from tests.stories.running import ROOT, RunningService
from tests.waiting import until
from worker.images.apart.video import Video

pytestmark = pytest.mark.one_database("it is about what a recording says; archives are imported into both")

MP4 = {"content-type": "video/mp4"}


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    with RunningService(tmp_path_factory.mktemp("videos")) as one:
        yield one


@pytest.fixture
def client(service: RunningService) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=service.url, timeout=60) as one:
        yield one


def sent(client: httpx.Client, name: str, body: bytes, kind: dict[str, str] = MP4, **params: str) -> dict[str, Any]:
    """The result of an import."""
    answer = client.post(f"/maps/{name}/imports", params=params, content=body, headers=kind)
    assert answer.status_code == 202, answer.text
    job = ended(client, answer.json()["id"])
    assert job["state"] == "done", job
    result: dict[str, Any] = job["result"]
    return result


def views_of(client: httpx.Client, name: str) -> list[dict[str, Any]]:
    views: list[dict[str, Any]] = client.get("/views", params={"map": name}).json()["views"]
    return views


def counts(result: dict[str, Any]) -> tuple[int, ...]:
    return tuple(result[name] for name in ("images", "enrolled", "already_there", "failed"))


def test_a_frame_every_two_seconds_is_enrolled_and_found_again(client: httpx.Client, tmp_path: Path) -> None:
    images = frames(20, 256)
    body = video(tmp_path / "a.mp4", images, 2, "mp4v")

    assert counts(sent(client, "walk", body, every="2s")) == (5, 5, 0, 0)
    assert [view["metadata"] for view in views_of(client, "walk")] == [{"video_s": 2.0 * i} for i in range(5)]
    answer = client.post(
        "/query?map=walk", content=encoded(images[12][..., ::-1]), headers={"content-type": "image/jpeg"}
    )
    assert answer.json()["matches"][0]["view"]["metadata"] == {"video_s": 6.0}

    assert counts(sent(client, "walk", body, every="2s")) == (5, 0, 5, 0)
    assert counts(sent(client, "walk", body)) == (10, 5, 5, 0)  # one a second


def test_a_robot_that_stands_still_is_not_enrolled_again_and_again(client: httpx.Client, tmp_path: Path) -> None:
    still, moved = frames(2, 128)
    body = video(tmp_path / "a.avi", [still] * 4 + [moved] * 2, 1)
    assert counts(sent(client, "still", body, {"content-type": "application/octet-stream"})) == (6, 2, 4, 0)


def test_a_video_that_breaks_off_is_enrolled_up_to_there(client: httpx.Client, tmp_path: Path) -> None:
    whole = video(tmp_path / "a.avi", frames(12, 128), 1)
    result = sent(client, "broken", whole[: len(whole) // 2])
    assert 4 <= result["enrolled"] < 8
    assert result["failed"] <= 1
    assert "the file says it lasts 12.0" in result["errors"][0]["detail"]


def test_a_360_video_becomes_eight_views_of_each_frame(client: httpx.Client, tmp_path: Path) -> None:
    wide = [cv2.resize(image, (256, 128)) for image in frames(4)]
    result = sent(client, "round", video(tmp_path / "a.avi", wide, 1), every="2s", panorama="true")
    assert (result["images"], result["failed"]) == (16, 0)


@pytest.mark.parametrize(
    ("params", "detail"),
    [
        ({"every": "1m"}, "a video does not say where it was taken"),
        ({"exif": "true"}, "exif: is of no use with a video"),
        ({"exif": "true", "every": "1m"}, "every: a video does not say where"),
        ({"every": "0s"}, "needs seconds such as 2s"),
        ({"image_topic": "/camera"}, "image_topic: is of use only with a recording of ROS 2"),
        ({"every": "2"}, "needs seconds such as 2s"),
        ({"every": "2s 1m"}, "needs seconds such as 2s"),
    ],
)
def test_a_step_that_cannot_be_is_refused(
    client: httpx.Client, tmp_path: Path, params: dict[str, str], detail: str
) -> None:
    body = video(tmp_path / "a.avi", frames(2), 1)
    refused = client.post("/maps/none/imports", params=params, content=body, headers=MP4)
    assert (refused.status_code, refused.json()["type"]) == (422, "urn:revisit:problem:invalid-parameter")
    assert detail in refused.text
    assert client.get("/maps/none").status_code == 404


def test_a_file_that_only_begins_like_a_video_is_refused(client: httpx.Client, service: RunningService) -> None:
    refused = client.post("/maps/none/imports", content=b"\0\0\0\x18ftypisom" + bytes(100_000), headers=MP4)
    assert refused.status_code == 400
    assert "the video is refused: it is damaged, or its codec" in refused.json()["detail"]
    assert not any((service.data / "imports").iterdir())


def test_a_kill_in_the_middle_of_a_video_loses_nothing_and_doubles_nothing(tmp_path: Path) -> None:
    body = video(tmp_path / "a.avi", frames(60, 128), 1)
    environment = {"REVISIT_LEASE_S": "1"}
    with (
        RunningService(tmp_path / "data", **environment) as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):
        job_id = client.post("/maps/walk/imports", content=body, headers=MP4, timeout=60).json()["id"]
        while client.get("/maps/walk").json()["views"]["ready"] < 10:
            time.sleep(0.01)
        service.kill()
    with (
        RunningService(tmp_path / "data", **environment) as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):
        assert counts(ended(client, job_id)["result"]) == (60, 60, 0, 0)
        assert client.get("/maps/walk").json()["views"] == {"pending": 0, "ready": 60, "failed": 0}


def decoder_of(pid: int) -> psutil.Process | None:
    """The process that sends the frames of a video to a service."""
    for process in psutil.Process(pid).children():
        with suppress(psutil.Error):
            if {Video.CHILD, "send"} <= set(process.cmdline()):
                return process
    return None


def test_a_stop_waits_for_no_frame_that_is_far(tmp_path: Path) -> None:
    """Between the frames that are wanted, thousands may be decoded."""
    body = video(tmp_path / "a.avi", frames(4, 256), 1)
    with RunningService(tmp_path / "data") as service, httpx.Client(base_url=service.url, timeout=60) as client:
        assert client.post("/maps/walk/imports?every=2s", content=body, headers=MP4).status_code == 202
        decoder = until(lambda: decoder_of(service.pid))
        decoder.suspend()  # the next frame never comes
        try:
            began = time.monotonic()
            service.stop()
            assert time.monotonic() - began < 10
        finally:
            if decoder.is_running():
                decoder.kill()
    assert any((tmp_path / "data" / "imports").iterdir())  # to be gone on with


def test_of_images_those_are_enrolled_that_are_far_enough_in_place_or_time(client: httpx.Client) -> None:
    rows = "".join(f"{i:04}.jpg,{0.4 * i:g},0,{1767225600 + 0.5 * i}\n" for i in range(10))
    files = {**photos(11), "manifest.csv": "file,x,y,captured_at\n" + rows}

    by_place = sent(client, "metres", zipped(files), ZIP, every="1m")
    by_time = sent(client, "seconds", zipped(files), ZIP, every="2s")

    assert [view["position"]["x"] for view in views_of(client, "metres")] == pytest.approx([0, 1.2, 2.4, 3.6])
    assert [view["filename"] for view in views_of(client, "seconds")] == ["0000.jpg", "0004.jpg", "0008.jpg"]
    assert [(r["images"], r["enrolled"], r["left_out"]) for r in (by_place, by_time)] == [(4, 4, 7), (3, 3, 8)]
    assert any("has no position" in error["detail"] for error in by_place["errors"])


def test_images_of_which_nothing_is_known_cannot_be_chosen_by_it(client: httpx.Client) -> None:
    refused = client.post("/maps/none/imports?every=1m", content=zipped(photos(3)), headers=ZIP)
    assert refused.status_code == 422
    assert "no image of the recording has a position" in refused.text


def test_videos_are_imported_in_a_data_folder_whose_name_is_not_utf8(tmp_path: Path) -> None:
    """As on a disk from other days. OpenCV crashed, and `doctor` could not open the database."""
    data = tmp_path / os.fsdecode(b"caf\xe9")
    data.mkdir()
    body = video(tmp_path / "a.avi", frames(4, 256), 1)
    with RunningService(data) as one, httpx.Client(base_url=one.url, timeout=60) as client:
        result = sent(client, "walk", body, {"content-type": "application/octet-stream"})
        doctor = [sys.executable, "-m", "app.cli", "doctor", "--data", str(data), "--url", one.url]
        told = subprocess.run(doctor, cwd=ROOT, capture_output=True, check=False, text=True)
    assert counts(result) == (4, 4, 0, 0)
    assert told.returncode == 0, told.stdout + told.stderr
    assert "4 of 4 images find themselves" in told.stdout
