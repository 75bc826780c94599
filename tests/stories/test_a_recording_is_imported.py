"""A recording is sent as a zip: its images are enrolled with what the manifest knows, whatever happens meanwhile."""

import io
import json
import signal
import time
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import httpx
import pytest
from PIL import Image as PilImage

from lab.faults.heics import heics
from tests.sample_images import drawn, encoded, photo
from tests.stories.importing import ZIP, ended, is_emptied, photos, zipped
from tests.stories.running import RunningService
from tests.waiting import until


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory, database: str) -> Iterator[RunningService]:
    with RunningService(tmp_path_factory.mktemp("imports"), REVISIT_MAX_IMPORT_MB="2") as one:
        yield one


@pytest.fixture
def client(service: RunningService) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=service.url, timeout=60) as one:
        yield one


def sent(client: httpx.Client, name: str, files: Mapping[str, bytes | str], **params: str) -> dict[str, Any]:
    """The ended job of an import."""
    answer = client.post(f"/maps/{name}/imports", params=params, content=zipped(files), headers=ZIP)
    assert answer.status_code == 202, answer.text
    assert answer.headers["location"] == f"/jobs/{answer.json()['id']}"
    return ended(client, answer.json()["id"])


def test_a_recording_with_a_manifest_is_enrolled_and_each_fault_is_told(
    client: httpx.Client, service: RunningService
) -> None:
    manifest = (
        "Filename;Easting;Northing;heading;timestamp;camera\n"
        "0000.jpg;1,5;2;350;1767225600;front\n"
        "walk/0001.jpg;3;4;-90;2026-01-01T00:00:00Z;rear\n"
        "0002.jpg;far;4;;;\n"
        "0009.jpg;5;6;;;\n"
    )
    files = {**photos(4), "walk/broken.png": photo(9, "png")[:-30], "notes.txt": "a fine day", "manifest.csv": manifest}
    files |= {"walk/positions.csv": "file,x,y\n0000.jpg,1,2\n"}

    job = sent(client, "walk", files)

    assert (job["kind"], job["state"], job["progress"]) == ("import", "done", {"done": 5, "total": 5})
    report = job["result"]
    assert {key: report[key] for key in ("images", "enrolled", "already_there", "failed")} == {
        "images": 5,
        "enrolled": 3,
        "already_there": 0,
        "failed": 2,
    }
    assert (report["rows_without_file"], report["files_without_row"], report["errors_left_off"]) == (1, 2, 0)
    told = {(error["file"], error["problem"]): error["detail"] for error in report["errors"]}
    assert set(told) == {
        ("walk/0002.jpg", "bad-row"),
        ("0009.jpg", "no-file"),
        ("walk/0003.jpg", "no-row"),
        ("walk/broken.png", "no-row"),
        ("walk/broken.png", "undecodable-picture"),
        ("notes.txt", "no-image"),
        ("walk/positions.csv", "no-image"),
    }
    assert told["walk/positions.csv", "no-image"].endswith("; a manifest is named manifest.csv or manifest.ndjson")
    assert "line 4: x is 'far', which is no number" in told["walk/0002.jpg", "bad-row"]
    views = client.get("/views?map=walk").json()["views"]
    assert [view["state"] for view in views] == ["ready"] * 3
    first, second, bare = views
    assert {key: first["position"][key] for key in ("x", "y", "heading")} == {"x": 1.5, "y": 2.0, "heading": 350.0}
    assert first["captured_at"] == second["captured_at"] == "2026-01-01T00:00:00.000000Z"
    assert (first["metadata"], second["metadata"]) == ({"camera": "front"}, {"camera": "rear"})
    assert second["position"]["heading"] == 270.0
    assert (bare["position"], bare["metadata"]) == (None, {})
    assert is_emptied(service.data / "imports")


def test_the_same_recording_again_adds_nothing(client: httpx.Client) -> None:
    rows = "\n".join(f'{{"file": "{i:04}.jpg", "place": "p{i}", "floor": {i}}}' for i in range(3))
    files = {**photos(3), "manifest.ndjson": rows}
    first = sent(client, "twice", files)["result"]
    again = sent(client, "twice", {**files, **photos(4)})["result"]

    assert (first["enrolled"], first["already_there"]) == (3, 0)
    assert (again["enrolled"], again["already_there"], again["failed"]) == (1, 3, 0)
    assert [view["metadata"] for view in client.get("/views?map=twice&place=p2").json()["views"]] == [{"floor": 2}]


def test_a_recording_that_is_sent_again_while_it_is_imported_is_there_already(client: httpx.Client) -> None:
    begun = [client.post("/maps/both/imports", content=zipped(photos(12)), headers=ZIP).json() for _ in range(2)]
    reports = [ended(client, job["id"])["result"] for job in begun]
    assert [(report["enrolled"], report["already_there"]) for report in reports] == [(12, 0), (0, 12)]


def test_other_attributes_for_an_image_that_is_there_are_an_error(client: httpx.Client) -> None:
    sent(client, "moved", {**photos(1), "manifest.csv": "file,x,y\n0000.jpg,1,2\n"})

    report = sent(client, "moved", {**photos(1), "manifest.csv": "file,x,y\n0000.jpg,1,3\n"})["result"]

    assert (report["already_there"], report["failed"], report["errors"][0]["problem"]) == (0, 1, "conflict")


def test_an_import_is_cancelled_and_what_it_enrolled_stays(client: httpx.Client, service: RunningService) -> None:
    answer = client.post("/maps/long/imports", content=zipped(photos(300, 96)), headers=ZIP)
    while client.get(f"/jobs/{answer.json()['id']}").json()["state"] == "waiting":
        time.sleep(0.01)

    cancelled = client.delete(f"/jobs/{answer.json()['id']}").json()

    assert (cancelled["state"], cancelled["failure"]["code"]) == ("cancelled", "cancelled")
    assert not any((service.data / "imports").iterdir())
    until(lambda: client.get("/maps/long").json()["views"]["pending"] == 0)
    assert client.get("/maps/long").json()["views"]["ready"] < 300
    assert sent(client, "after", photos(1))["state"] == "done"


def test_where_the_manifest_is_silent_the_photo_says_where_it_was_taken(client: httpx.Client) -> None:
    exif = PilImage.Exif()
    exif.get_ifd(0x8825).update({1: "N", 2: (50.0, 30.0, 0.0), 3: "E", 4: (14.0, 0.0, 0.0), 16: "T", 17: 90.0})
    exif.get_ifd(0x8825).update({29: "2026:05:04", 7: (9.0, 30.0, 0.0)})
    files = {f"{name}.jpg": encoded(drawn(64, 48, n), "jpeg", exif=exif) for n, name in enumerate("ab")}
    files["c.heic"] = heics()["turned"]
    told: dict[str, bytes | str] = {**files, "manifest.csv": "file,lat,lon,place\nb.jpg,1,2,hall\n"}
    metric: dict[str, bytes | str] = {**files, "manifest.csv": "file,x,y\nb.jpg,1,2\n"}

    assert sent(client, "exif", told, exif="true")["result"]["enrolled"] == 3
    assert sent(client, "exif", told, exif="true")["result"]["already_there"] == 3
    assert sent(client, "metric", metric, exif="true")["result"]["enrolled"] == 3
    assert sent(client, "silent", told)["result"]["enrolled"] == 3

    def views(name: str) -> list[dict[str, Any]]:
        found = {view["filename"]: view for view in client.get(f"/views?map={name}").json()["views"]}
        return [found[file] for file in ("a.jpg", "b.jpg", "c.heic")]

    a, b, c = views("exif")
    assert (a["position"]["lat"], a["position"]["heading"]) == (50.5, 90)
    assert a["captured_at"] == b["captured_at"] == "2026-05-04T09:30:00.000000Z"
    assert (b["position"]["lat"], b["position"]["heading"]) == (1, None)
    assert c["position"]["lat"] == pytest.approx(50 + 5 / 60)
    assert [(view["position"] or {}).get("x") for view in views("metric")] == [None, 1, None]
    assert all((view["position"] or {}).get("lat") is None for view in views("metric"))
    assert (views("silent")[0]["position"], views("silent")[0]["captured_at"]) == (None, None)


def test_a_trajectory_says_where_the_images_were_taken(client: httpx.Client) -> None:
    images = {f"rgb/{10 + n / 10:.2f}.png": photo(n, "png") for n in range(4)}
    level = "-0.7071068 0 0 0.7071068"
    poses = "".join(f"{10 + n / 10 + 0.01} {n} {2 * n} 0 {level}\n" for n in range(3))

    report = sent(client, "tum", {**images, "groundtruth.txt": f"# time tx ty tz qx qy qz qw\n{poses}"})["result"]
    broken = client.post("/maps/broken/imports", content=zipped({**images, "poses.txt": "1 2 3\n"}), headers=ZIP)

    assert (report["enrolled"], report["files_without_row"]) == (4, 1)
    views = client.get("/views?map=tum").json()["views"]
    assert [(view["position"] or {}).get("y") for view in views] == [0, 2, 4, None]
    assert views[1]["position"]["heading"] == pytest.approx(0, abs=1e-3)
    assert broken.status_code == 400
    assert "poses.txt, line 1: has 3 numbers" in broken.json()["detail"]


def test_a_panorama_becomes_eight_views_with_their_headings(client: httpx.Client) -> None:
    exif = PilImage.Exif()
    exif.get_ifd(0x8825).update({1: "N", 2: (50.0, 30.0, 0.0), 3: "E", 4: (14.0, 0.0, 0.0), 16: "T", 17: 90.0})
    files: dict[str, bytes | str] = {
        "a.jpg": encoded(drawn(512, 256, 3), "jpeg", exif=exif),
        "b.jpg": encoded(drawn(512, 256, 4)),
        "flat.jpg": encoded(drawn(400, 300, 5)),
    }

    report = sent(client, "round", files, panorama="true", exif="true")["result"]
    again = sent(client, "round", files, panorama="true", exif="true")["result"]

    assert (report["images"], report["enrolled"], report["failed"]) == (24, 16, 8)
    assert {error["file"] for error in report["errors"]} == {f"flat.jpg#{45 * n:03}" for n in range(8)}
    assert "twice as wide as high" in report["errors"][0]["detail"]
    assert (again["already_there"], again["failed"]) == (16, 8)
    views = client.get("/views?map=round&limit=50").json()["views"]
    assert [view["filename"] for view in views] == ["a.jpg"] * 8 + ["b.jpg"] * 8
    assert [view["position"]["heading"] for view in views[:8]] == [90, 135, 180, 225, 270, 315, 0, 45]
    assert all(view["position"] is None for view in views[8:])


def jobs_of(answer: httpx.Response) -> Iterator[dict[str, Any]]:
    """The jobs of server-sent events, as they come."""
    for line in answer.iter_lines():
        if line.startswith("data: "):
            yield json.loads(line.removeprefix("data: "))


def test_an_import_is_followed_while_it_runs(client: httpx.Client) -> None:
    job_id = client.post("/maps/followed/imports", content=zipped(photos(60)), headers=ZIP).json()["id"]

    with client.stream("GET", f"/jobs/{job_id}/events") as answer:
        seen = list(jobs_of(answer))

    done = [job["progress"]["done"] for job in seen if job["progress"]]
    assert done == sorted(done)
    assert len(set(done)) > 1, "it was followed only when it was over"
    assert (seen[-1]["state"], done[-1]) == ("done", 60)


def test_events_end_with_the_service(tmp_path: Path) -> None:
    with (
        RunningService(tmp_path) as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):
        job_id = client.post("/maps/long/imports", content=zipped(photos(300, 96)), headers=ZIP).json()["id"]
        with client.stream("GET", f"/jobs/{job_id}/events") as answer:
            jobs = jobs_of(answer)
            next(jobs)
            service.signal(signal.SIGTERM)

            assert [job["state"] for job in jobs if job["state"] not in ("waiting", "running")] == []
        assert service.wait() == 0


def test_a_deleted_map_takes_its_import_along(client: httpx.Client, service: RunningService) -> None:
    client.post("/maps/gone/imports", content=zipped(photos(200, 96)), headers=ZIP)
    client.post("/maps/gone/imports", content=zipped(photos(3)), headers=ZIP)

    assert client.delete("/maps/gone").status_code == 200

    assert sent(client, "after", photos(1))["state"] == "done"
    assert client.get("/maps/gone").status_code == 404
    assert is_emptied(service.data / "imports")


def test_a_kill_in_the_middle_loses_nothing_and_doubles_nothing(tmp_path: Path) -> None:
    data, environment = tmp_path / "data", {"REVISIT_LEASE_S": "1"}
    dark: dict[str, bytes | str] = {f"walk/{i:04}.jpg": encoded(drawn(96, 96, i) // 16) for i in range(60)}
    job_id, killed = None, False
    while True:
        with RunningService(data, **environment) as service, httpx.Client(base_url=service.url, timeout=60) as client:
            if job_id is None:
                answer = client.post("/maps/walk/imports", content=zipped(dark), headers=ZIP)
                job_id = answer.json()["id"]
            before = client.get("/maps/walk").json()["views"]["ready"]
            while not killed and (now := client.get("/maps/walk").json()["views"]["ready"]) < min(before + 10, 60):
                time.sleep(0.01)
            if not killed:
                killed = True
                assert now < 60, "it was over before the kill"
                service.kill()
                continue
            job = ended(client, job_id)
            assert (job["state"], job["progress"]) == ("done", {"done": 60, "total": 60})
            report = job["result"]
            assert (report["enrolled"], report["already_there"], report["errors"]) == (60, 0, [])
            assert report["poor"] == 60
            assert client.get("/maps/walk").json()["views"] == {"pending": 0, "ready": 60, "failed": 0}
            assert is_emptied(data / "imports")
            return


def test_a_photo_that_is_deleted_meanwhile_does_not_come_back_after_a_kill(tmp_path: Path) -> None:
    data, environment = tmp_path / "data", {"REVISIT_LEASE_S": "1"}
    with RunningService(data, **environment) as service, httpx.Client(base_url=service.url, timeout=60) as client:
        job_id = client.post("/maps/walk/imports", content=zipped(photos(60, 96)), headers=ZIP).json()["id"]
        while not (views := client.get("/views?map=walk&state=ready").json()["views"]):
            time.sleep(0.01)
        assert client.delete(f"/views/{views[0]['id']}").json()["views"] == 1
        assert client.get(f"/jobs/{job_id}").json()["state"] == "running", "it was over before the kill"
        service.kill()

    with RunningService(data, **environment) as service, httpx.Client(base_url=service.url, timeout=60) as client:
        report = ended(client, job_id)["result"]
        assert (report["enrolled"], report["already_there"], report["failed"]) == (59, 0, 1)
        [error] = report["errors"]
        assert (error["file"].rpartition("/")[2], error["problem"]) == (views[0]["filename"], "not-found")
        names = [view["filename"] for view in client.get("/views?map=walk&limit=100").json()["views"]]
        assert len(names) == 59
        assert views[0]["filename"] not in names


def lying_about_its_size() -> bytes:
    return zipped({"a.jpg": photo(1)}).replace(b"PK\x05\x06\0\0\0\0\x01\0\x01\0", b"PK\x05\x06\0\0\0\0\xff\xff\xff\xff")


def linking() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        link = zipfile.ZipInfo("a.jpg")
        link.external_attr = 0o120777 << 16
        archive.writestr(link, "/etc/passwd")
    return out.getvalue()


def bomb() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.bmp", bytes(40_000_000))
    return out.getvalue()


def of_many_files() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for number in range(15_000):
            archive.writestr(f"{number}.jpg", b"")
    raw = bytearray(out.getvalue())
    raw[-12:-10] = (60_000).to_bytes(2, "little")
    return bytes(raw)


@pytest.mark.parametrize(
    ("body", "status", "words"),
    [
        (b"", 400, "it is empty"),
        (b"hello", 400, "no zip archive"),
        (photo(1), 400, "no zip archive"),
        (zipped(photos(2))[:-30], 400, "breaks off"),
        (zipped({"notes.txt": "none"}), 400, "holds no image"),
        (zipped({"../a.jpg": photo(1)}), 400, "leads out of the archive"),
        (zipped({"walk\\..\\..\\a.jpg": photo(1)}), 400, "leads out of the archive"),
        (zipped({"/etc/a.jpg": photo(1)}), 400, "is absolute"),
        (zipped({"C:/a.jpg": photo(1)}), 400, "is absolute"),
        (zipped({"a\nb.jpg": photo(1)}), 400, "control characters"),
        (zipped({"a" * 2000 + ".jpg": photo(1)}), 400, "2,004 letters"),
        (zipped({"a/b.jpg": photo(1), "a\\b.jpg": photo(2)}), 400, "two of its files have the name"),
        (linking(), 400, "symbolic link"),
        (bomb(), 400, "more than 100 times as many"),
        (of_many_files(), 413, "60,000 files"),
        (zipped({**photos(1), "manifest.csv": "x,y\n1,2\n"}), 400, "needs to name a column file"),
        (zipped({**photos(1), "manifest.csv": "file,x,easting\na,1,2\n"}), 400, "both mean x"),
        (zipped({**photos(1), "manifest.csv": "file,x\na,1\na,2\n"}), 400, "lines 2 and 3 are both about a"),
        (zipped({**photos(1), "manifest.csv": b"\xff\xfe\0"}), 400, "UTF-8"),
        (zipped({**photos(1), "manifest.ndjson": "[1]"}), 400, "needs to be a JSON object"),
        (zipped({**photos(1), "manifest.csv": "file", "b/manifest.csv": "file"}), 400, "2 manifests"),
        (zipped({"a.jpg": bytes(2_100_000)}), 413, "at most 2,000,000 are taken"),
    ],
)
def test_a_hostile_archive_is_refused_in_words_and_leaves_nothing(
    client: httpx.Client, service: RunningService, body: bytes, status: int, words: str
) -> None:
    answer = client.post("/maps/hostile/imports", content=body, headers=ZIP)

    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
    assert words in answer.json()["detail"]
    assert client.get("/maps/hostile").status_code == 404
    assert not (service.data / "imports").exists() or not any((service.data / "imports").iterdir())


def test_a_directory_that_lies_about_its_files_is_no_way_in(client: httpx.Client) -> None:
    answer = client.post("/maps/hostile/imports", content=lying_about_its_size(), headers=ZIP)

    assert answer.status_code == 413


def test_an_image_that_is_damaged_in_the_archive_is_an_error_of_its_own(client: httpx.Client) -> None:
    whole = zipped(photos(2))
    at = whole.index(encoded(drawn(64, 64, 1))) + 100
    torn = whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :]

    job = ended(client, client.post("/maps/torn/imports", content=torn, headers=ZIP).json()["id"])

    assert (job["result"]["enrolled"], job["result"]["failed"]) == (1, 1)
    assert job["result"]["errors"][0]["file"] == "walk/0001.jpg"
    assert "damaged in the archive" in job["result"]["errors"][0]["detail"]
