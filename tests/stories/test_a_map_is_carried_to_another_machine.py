"""A map is written to a file while the service works, carried elsewhere, and answers there as it did."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from app.http.application import create_app
from tests.openapi import CheckedClient
from tests.sample_images import drawn, encoded
from tests.stories.importing import ended
from tests.stories.running import settings
from worker.runtime import build

JPEG = {"content-type": "image/jpeg"}
TAR = {"content-type": "application/x-tar"}


@contextmanager
def service(data: Path, **said: Any) -> Iterator[CheckedClient]:
    runtime = build(settings(data, **said))
    with CheckedClient(create_app(runtime)) as client:
        yield client


@pytest.fixture
def home(tmp_path: Path) -> Iterator[CheckedClient]:
    """A service with a map of six views of four places."""
    with service(tmp_path / "home") as client:
        for seed in range(6):
            client.post(f"/enroll?map=campus&place={seed % 4}&x={seed}&y=0", content=street(seed), headers=JPEG)
        yield client


@pytest.fixture
def away(tmp_path: Path) -> Iterator[CheckedClient]:
    """Another service, which keeps a little less than it takes for a snapshot in the body of other requests."""
    with service(tmp_path / "away", max_body_mb=0.05) as client:
        yield client


def street(seed: int) -> bytes:
    return encoded(drawn(160, 120, seed), "jpeg")


def snapshot(client: CheckedClient, name: str = "campus") -> tuple[str, bytes]:
    """Id and bytes of a new snapshot."""
    started = client.post(f"/maps/{name}/snapshots")
    assert started.status_code == 202, started.text
    job = ended(client, started.json()["id"])
    assert (job["state"], job["result"]["snapshot"]) == ("done", job["id"]), job
    file = client.get(f"/snapshots/{job['id']}")
    assert len(file.content) == int(file.headers["content-length"]) == job["result"]["bytes"]
    return job["id"], file.content


def ranking(client: CheckedClient, name: str, seed: int) -> list[tuple[Any, ...]]:
    answer = client.post(f"/query?map={name}&top=6", content=street(seed), headers=JPEG).json()
    return [(m["view"]["id"], m["view"]["place"], m["score"], m["parts"]) for m in answer["matches"]]


def test_there_it_gives_the_same_answers(home: CheckedClient, away: CheckedClient) -> None:
    snapshot_id, file = snapshot(home)
    [listed] = home.get("/snapshots").json()["snapshots"]
    assert (listed["id"], listed["map"], listed["views"], listed["bytes"]) == (snapshot_id, "campus", 6, len(file))

    restored = away.post("/restore", content=file, headers=TAR)

    assert restored.status_code == 201, restored.text
    assert restored.json() | {"revision": 0, "links": {}} == {
        "map": "campus",
        "snapshot": snapshot_id,
        "views": 6,
        "pending": 0,
        "revision": 0,
        "new_ids": False,
        "links": {},
    }
    for seed in (0, 3, 9):
        assert ranking(away, "campus", seed) == ranking(home, "campus", seed)
    view = away.get("/views?map=campus").json()["views"][2]
    assert away.get(view["links"]["image"]).content == home.get(view["links"]["image"]).content
    assert away.get("/maps/campus").json()["recipe"] == home.get("/maps/campus").json()["recipe"]
    assert away.post("/enroll?map=campus", content=street(7), headers=JPEG).status_code == 201


def test_over_a_map_that_is_there_it_is_refused_and_under_another_name_it_stands_beside_it(home: CheckedClient) -> None:
    _, file = snapshot(home)
    before = home.get("/views?map=campus").json()

    assert home.post("/restore", content=file, headers=TAR).status_code == 409
    copy = home.post("/restore?as=copy", content=file, headers=TAR).json()

    assert (copy["map"], copy["views"], copy["new_ids"]) == ("copy", 6, True)
    assert [match[1:] for match in ranking(home, "copy", 3)] == [match[1:] for match in ranking(home, "campus", 3)]
    assert home.get("/views?map=campus").json() == before


def test_what_is_no_whole_snapshot_is_refused_in_words(home: CheckedClient, away: CheckedClient) -> None:
    _, file = snapshot(home)
    flipped = bytearray(file)
    flipped[len(file) // 2] ^= 1

    for body, told in (
        (bytes(flipped), "changed"),
        (file[: len(file) // 2], "cut off"),
        (b"PK\x03\x04" + bytes(2000), "no snapshot of revisit"),
        (b"", "empty"),
    ):
        refused = away.post("/restore", content=body, headers=TAR)
        assert (refused.status_code, refused.json()["type"]) == (400, "urn:revisit:problem:malformed-body")
        assert told in refused.json()["detail"]
    for query in ("as=../etc", "as=a&as=b", "name=copy"):
        assert away.post(f"/restore?{query}", content=file, headers=TAR).status_code == 422
    assert away.get("/maps").json()["maps"] == []
    assert away.post("/enroll", content=bytes(60_000), headers=JPEG).status_code == 413


def test_a_snapshot_stays_until_it_is_deleted(home: CheckedClient) -> None:
    snapshot_id, file = snapshot(home)
    assert home.delete("/maps/campus").status_code == 200
    assert home.post("/restore", content=home.get(f"/snapshots/{snapshot_id}").content, headers=TAR).status_code == 201

    assert home.delete(f"/snapshots/{snapshot_id}").json()["bytes"] == len(file)
    assert home.get(f"/snapshots/{snapshot_id}").status_code == 404
    assert home.delete(f"/snapshots/{snapshot_id}").status_code == 404
    assert home.get("/snapshots").json() == {"snapshots": []}
    assert home.post("/maps/nowhere/snapshots").status_code == 404


def test_a_download_goes_on_where_it_broke_off(home: CheckedClient) -> None:
    snapshot_id, file = snapshot(home)
    path, size = f"/snapshots/{snapshot_id}", len(file)
    whole = home.get(path)
    tag = whole.headers["etag"]
    assert whole.headers["accept-ranges"] == "bytes"

    for given, first, last in (
        ("bytes=0-0", 0, 0),
        ("bytes=1000-", 1000, size - 1),
        ("bytes=-1", size - 1, size - 1),
        (f"Bytes=5-{size + 9}", 5, size - 1),
        (f"bytes=-{size + 9}", 0, size - 1),
    ):
        part = home.get(path, headers={"range": given, "if-range": tag})
        assert (part.status_code, part.headers["etag"]) == (206, tag)
        assert part.headers["content-range"] == f"bytes {first}-{last}/{size}"
        assert int(part.headers["content-length"]) == last - first + 1
        assert part.content == file[first : last + 1]

    for given in ("bytes=0-1,5-6", "bytes=9-5", "bytes=-", "bytes=a-b", "pages=1-2", "bytes 1-2", "bytes=1-2-3"):
        all_of_it = home.get(path, headers={"range": given})
        assert (all_of_it.status_code, all_of_it.content == file) == (200, True), given
    for named in ('"another"', f"W/{tag}", "Sun, 01 Mar 2026 09:30:00 GMT"):
        all_of_it = home.get(path, headers={"range": "bytes=1-2", "if-range": named})
        assert (all_of_it.status_code, all_of_it.content == file) == (200, True), named
    for given in (f"bytes={size}-", "bytes=-0", f"bytes={10**18}-"):
        refused = home.get(path, headers={"range": given})
        assert (refused.status_code, refused.headers["content-range"]) == (416, f"bytes */{size}")
        assert refused.json()["type"] == "urn:revisit:problem:range-not-satisfiable"

    assert home.get(path, headers={"range": "bytes=1-2", "if-none-match": tag}).status_code == 304
    head = home.send(home.build_request("HEAD", path, headers={"range": "bytes=1-2"}))
    assert (head.status_code, head.headers["content-length"], head.headers["etag"]) == (200, str(size), tag)
    again, _ = snapshot(home)
    assert home.get(f"/snapshots/{again}").headers["etag"] != tag
