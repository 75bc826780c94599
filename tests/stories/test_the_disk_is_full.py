"""The disk runs full under a real service: everybody is answered, space can be freed, and it recovers by itself."""

import errno
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.cli.__main__ import main
from lab.faults.small_disk import NotMounted, fill, small_disk
from tests.failing_writes import failing_writes
from tests.sample_images import drawn, encoded
from tests.stories.importing import ZIP, is_emptied, zipped
from tests.stories.running import RunningService
from tests.waiting import PATIENCE_S
from worker.storage.space import LEAST_INODES

pytestmark = pytest.mark.one_database("the disk is that of SQLite's file")

JPEG = {"content-type": "image/jpeg"}
ANSWER_S = 10
DISK_MB, RESERVE_MB = 16, 4
SETTINGS = {
    "REVISIT_RESERVE_MB": str(RESERVE_MB),
    "REVISIT_WAIT": "5",
    "REVISIT_LEASE_S": "2",
    "REVISIT_COMPARE": "true",
}


def image(number: int) -> bytes:
    """A JPEG of some 100 KB that no other number has."""
    return encoded(drawn(640, 480, number))


@pytest.fixture
def disk(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Path]:
    """A small disk of its own; its parameter, if it has one, is the number of its inodes."""
    folder = tmp_path / "disk"
    folder.mkdir()
    try:
        with small_disk(folder, DISK_MB, getattr(request, "param", None)):
            yield folder
    except NotMounted as error:
        pytest.skip(f"NOT TRIED: a full disk needs the right to mount one ({error})")


@contextmanager
def serving(disk: Path, **environment: str) -> Iterator[tuple[RunningService, httpx.Client]]:
    """The service on that disk, and a client that gives up after `ANSWER_S`."""
    with (
        RunningService(disk / "data", **(SETTINGS | environment)) as service,
        httpx.Client(base_url=service.url, timeout=ANSWER_S) as client,
    ):
        yield service, client


def until(client: httpx.Client, true: Any) -> Any:
    """Wait until the readiness is so; the readiness."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        readiness = client.get("/readyz").json()
        if true(readiness):
            return readiness
        time.sleep(0.1)
    raise AssertionError(f"still {readiness}")


def is_ready(readiness: Any) -> bool:
    return bool(readiness["ready"])


def is_not_ready(readiness: Any) -> bool:
    return not readiness["ready"]


def await_nothing_pending(client: httpx.Client) -> dict[str, int]:
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        views: dict[str, int] = client.get("/maps/default").json()["views"]
        if views["pending"] == 0:
            return views
        time.sleep(0.1)
    raise AssertionError(f"still {views}")


@pytest.mark.slow
def test_enrolling_until_the_disk_is_full_and_deleting_until_it_is_not(disk: Path) -> None:
    with serving(disk) as (service, client):
        enrolled = []
        for number in range(2000):
            answer = client.post("/enroll", content=image(number), headers=JPEG)
            if answer.status_code != 201:
                break
            enrolled.append(answer.json()["view"]["id"])
        assert answer.status_code == 507, answer.text
        assert answer.json()["type"] == "urn:revisit:problem:disk-full"
        assert "MB" in answer.json()["detail"]
        readiness = until(client, is_not_ready)
        assert "full" in readiness["checks"]["disk"]
        assert readiness["checks"]["database"] == readiness["checks"]["encoder"] == "ok"

        # Another program takes what was left. Queries still answer, what was refused is not there.
        hog = fill(disk)
        assert client.post("/enroll", content=image(3000), headers=JPEG).status_code == 507
        found = client.post("/query", content=image(0), headers=JPEG)
        assert found.status_code == 200
        assert found.json()["matches"][0]["view"]["id"] == enrolled[0]
        assert found.json()["searched"] == len(enrolled)

        # Every deletion works, and in the end there is room again without anybody's help.
        for view in enrolled[1:]:
            answer = client.delete(f"/views/{view}")
            assert answer.status_code == 200, answer.text
        assert client.get("/views?limit=100").json()["views"][0]["id"] == enrolled[0]
        hog.unlink()
        until(client, is_ready)
        assert client.post("/enroll", content=image(3000), headers=JPEG).status_code == 201
        assert (disk / "data" / "reserve").stat().st_size == RESERVE_MB * 1_000_000
        assert service.stop() == 0


def test_views_accepted_before_the_disk_was_full_are_described_when_there_is_room(disk: Path) -> None:
    with serving(disk) as (service, client):
        first = client.post("/enroll", content=image(0), headers=JPEG).json()["view"]["id"]
        accepted = [
            client.post("/enroll?wait=false", content=image(number), headers=JPEG).json() for number in range(1, 9)
        ]
        hog = fill(disk)
        assert client.post("/enroll", content=image(50), headers=JPEG).status_code == 507
        until(client, is_not_ready)
        assert client.post("/query", content=image(0), headers=JPEG).json()["matches"][0]["view"]["id"] == first
        hog.unlink()
        until(client, is_ready)
        assert await_nothing_pending(client) == {"pending": 0, "ready": 9, "failed": 0}
        assert {client.get(f"/jobs/{one['job']}").json()["state"] for one in accepted} == {"done"}
        said = [line for line in service.output if "cannot be stored" in line]
        assert len(said) <= 2, "once for each change of state, not for each attempt"


def test_a_service_starts_on_a_full_disk_and_lets_it_be_emptied(disk: Path) -> None:
    with serving(disk) as (service, client):
        view = client.post("/enroll", content=image(0), headers=JPEG).json()["view"]["id"]
        service.kill()
    hog = fill(disk)
    with (
        RunningService(disk / "data", False, **SETTINGS) as service,
        httpx.Client(base_url=service.url, timeout=ANSWER_S) as client,
    ):
        assert "full" in until(client, is_not_ready)["checks"]["disk"]
        assert client.post("/query", content=image(0), headers=JPEG).json()["matches"][0]["view"]["id"] == view
        assert client.delete(f"/views/{view}").status_code == 200
        hog.unlink()
        until(client, is_ready)


@pytest.mark.parametrize("disk", [LEAST_INODES + 40], indirect=True)
def test_a_disk_that_takes_no_further_files_is_said_and_can_be_emptied(
    disk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Small images use up a disk's inodes while most of its bytes are free."""
    with serving(disk) as (service, client):
        enrolled: list[str] = []
        while (answer := client.post("/enroll", content=image(len(enrolled)), headers=JPEG)).status_code == 201:
            enrolled.append(answer.json()["view"]["id"])
        assert (answer.status_code, len(enrolled) > 5) == (507, True)
        assert "inodes are left (`df -i`)" in answer.json()["detail"]
        assert "inodes" in until(client, is_not_ready)["checks"]["disk"]
        assert "revisit_disk_free_inodes 9" in client.get("/metrics").text
        service.kill()
    assert main(["doctor", "--data", str(disk / "data"), "--url", "http://127.0.0.1:9"]) == 1
    assert "takes only 9" in capsys.readouterr().out

    others = disk / "others"
    others.mkdir()
    with suppress(OSError):
        for number in range(LEAST_INODES):
            (others / str(number)).touch()
    assert os.statvfs(disk).f_favail == 0
    with (
        RunningService(disk / "data", False, **SETTINGS) as service,
        httpx.Client(base_url=service.url, timeout=ANSWER_S) as client,
    ):
        assert "inodes" in until(client, is_not_ready)["checks"]["disk"]
        assert client.post("/query", content=image(0), headers=JPEG).json()["matches"][0]["view"]["id"] == enrolled[0]
        assert [client.delete(f"/views/{view}").status_code for view in enrolled[:5]] == [200] * 5
        shutil.rmtree(others)
        until(client, is_ready)
        assert client.post("/enroll", content=image(0), headers=JPEG).status_code == 201


def test_an_import_whose_recording_fills_the_disk_can_be_cancelled(disk: Path) -> None:
    with (
        RunningService(disk / "data", False, **SETTINGS, REVISIT_INLINE_WORKER="false") as service,
        httpx.Client(base_url=service.url, timeout=ANSWER_S) as client,
    ):
        client.put("/maps/default", json={})
        recording = zipped({f"{number}.jpg": image(number) for number in range(20)})
        job = client.post("/maps/default/imports", content=recording, headers=ZIP).json()["id"]
        hog = fill(disk)
        answer = client.delete(f"/jobs/{job}")
        assert answer.status_code == 200, answer.text
        assert answer.json()["state"] == "cancelled"
        assert is_emptied(disk / "data" / "imports")
        answer = client.patch("/maps/default", json={"keep_images": False})
        assert answer.status_code == 200, answer.text
        hog.unlink()


@pytest.mark.slow
@pytest.mark.parametrize("error", [errno.EROFS, errno.EIO, errno.EDQUOT, errno.ENOSPC], ids=errno.errorcode.get)
def test_a_disk_that_refuses_every_write_is_said_and_left_behind(tmp_path: Path, error: int) -> None:
    """Read-only after an error, broken, over quota, full whatever `statvfs` says."""
    with failing_writes(tmp_path) as faults, serving(tmp_path, **faults.environment) as (service, client):
        view = client.post("/enroll", content=image(0), headers=JPEG).json()["view"]["id"]
        faults.fail(error)
        answers = [
            client.post("/enroll", content=image(1), headers=JPEG),
            client.post("/enroll", content=image(1), headers=JPEG | {"Idempotency-Key": "one"}),
            client.delete(f"/views/{view}"),
            client.patch(f"/views/{view}", json={"place": "hall"}),
            client.put("/maps/other", json={}),
        ]
        full = error in (errno.ENOSPC, errno.EDQUOT)
        assert {answer.status_code for answer in answers} <= ({507} if full else {503, 507}), [a.text for a in answers]
        assert {answer.headers["content-type"] for answer in answers} == {"application/problem+json"}
        readiness = until(client, is_not_ready)
        assert readiness["checks"]["disk"] != "ok"
        assert readiness["checks"]["encoder"] == "ok"
        assert client.post("/query", content=image(0), headers=JPEG).json()["matches"][0]["view"]["id"] == view
        faults.end()
        until(client, is_ready)
        assert client.get("/maps/default").json()["views"] == {"pending": 0, "ready": 1, "failed": 0}
        assert client.post("/enroll", content=image(1), headers=JPEG).status_code == 201
        assert not [line for line in service.output if "Traceback" in line]


def test_a_caller_who_waits_is_told_when_the_description_cannot_be_stored(tmp_path: Path) -> None:
    """Refused with nothing left behind, or kept and described later: never without an answer."""
    with failing_writes(tmp_path) as faults, serving(tmp_path, **faults.environment) as (_, client):
        client.post("/enroll", content=image(0), headers=JPEG)
        kept = refused = 0
        for number in range(1, 1000, 6):
            faults.fail(errno.ENOSPC, after=number)
            answer = client.post("/enroll", content=image(number), headers=JPEG)
            failed = faults.end()
            assert answer.status_code in (201, 202, 503, 507), answer.text
            kept += answer.status_code < 300
            refused += answer.status_code >= 500
            until(client, is_ready)
            if answer.status_code == 201 and not failed:
                break
        assert kept
        assert refused
        assert await_nothing_pending(client) == {"pending": 0, "ready": 1 + kept, "failed": 0}
