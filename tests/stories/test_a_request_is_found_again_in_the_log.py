"""A caller reports the id of an error; the operator finds everything that the request caused."""

import io
import json
import sqlite3
from pathlib import Path
from typing import Any

import httpx
import pytest
from PIL import Image

from tests.sample_images import exif_of_a_phone, photo
from tests.stories.running import RunningService
from tests.waiting import until

pytestmark = pytest.mark.one_database("the log is the same, and one test breaks a file of SQLite")

JPEG = {"content-type": "image/jpeg"}


def lines(service: RunningService) -> list[dict[str, Any]]:
    return [json.loads(line) for line in service.output if line.startswith("{")]


def test_every_line_of_a_failing_request_has_the_id_of_its_problem(tmp_path: Path) -> None:
    with RunningService(tmp_path, REVISIT_LOG="json") as service:
        httpx.post(f"{service.url}/enroll", content=photo(), headers=JPEG, timeout=60).raise_for_status()
        database = sqlite3.connect(tmp_path / "revisit.db")
        database.execute("DROP TABLE metadata_pairs")
        database.commit()
        database.close()
        answer = httpx.get(f"{service.url}/views?map=default&metadata.colour=red", timeout=60)
        assert answer.status_code == 500, answer.text
    mine = [line for line in lines(service) if line.get("request_id") == answer.json()["request_id"]]
    (failed,) = [line for line in mine if "traceback" in line]
    assert "no such table: metadata_pairs" in failed["traceback"]
    (access,) = [line for line in mine if line.get("event") == "request"]
    assert (access["status"], access["problem"], access["level"]) == (500, "internal", "warning")


def test_nothing_private_is_in_the_log_and_the_view_of_a_request_is(tmp_path: Path) -> None:
    private = {"authorization": "Bearer secret-of-the-caller", "x-api-key": "another-secret"}
    with RunningService(tmp_path, REVISIT_LOG="json", REVISIT_LOG_LEVEL="debug", REVISIT_SLOW_S="0.000001") as service:
        enrolled = httpx.post(
            f"{service.url}/enroll?lat=48.137222&lon=11.575555&metadata=%7B%22who%22%3A%22anna%22%7D",
            content=photo(),
            headers=JPEG | private | {"x-request-id": "mine"},
            timeout=60,
        ).json()
    (access,) = [line for line in lines(service) if line.get("request_id") == "mine" and line.get("event") == "request"]
    assert access["view_ids"] == [enrolled["view"]["id"]]
    assert (access["slow"], access["level"]) == (True, "warning")
    text = "".join(service.output)
    for secret in ("secret", "48.137", "11.575", "anna", "JFIF"):
        assert secret not in text


def test_what_a_photo_says_of_who_took_it_is_in_no_line_however_much_is_logged(tmp_path: Path) -> None:
    exif, taken = exif_of_a_phone(), io.BytesIO()
    exif[0x010E], exif[0x013B] = "the garden of anna", "bertha"  # ImageDescription, Artist
    Image.open(io.BytesIO(photo())).save(taken, "JPEG", exif=exif)
    with RunningService(tmp_path, REVISIT_LOG="json", REVISIT_LOG_LEVEL="debug", REVISIT_DECODERS="0") as service:
        address = f"{service.url}/enroll?exif=true"
        enrolled = httpx.post(address, content=taken.getvalue(), headers=JPEG, timeout=60).json()
        stripped = httpx.get(service.url + enrolled["view"]["links"]["image"], timeout=60)
        assert stripped.status_code == 200
    text = "".join(service.output)
    assert '"GET /views/' in text
    for secret in ("garden", "bertha", "2026:05:04"):
        assert secret not in text


def test_a_statement_that_fails_is_logged_without_what_was_sent(tmp_path: Path) -> None:
    with RunningService(tmp_path, REVISIT_LOG="json") as service:
        database = sqlite3.connect(tmp_path / "revisit.db")
        database.execute("CREATE TRIGGER fails BEFORE INSERT ON views BEGIN SELECT RAISE(ABORT, 'for no reason'); END")
        database.commit()
        database.close()
        said = "place=annas+garden&lat=48.137222&lon=11.575555&metadata=%7B%22who%22%3A%22bertha%22%7D"
        answer = httpx.post(f"{service.url}/enroll?{said}", content=photo(), headers=JPEG, timeout=60)
        assert answer.status_code == 500, answer.text
    assert [line for line in lines(service) if "for no reason" in line.get("traceback", "")]
    text = "".join(service.output)
    for secret in ("garden", "48.137", "11.575", "bertha"):
        assert secret not in text


def test_only_what_is_slow_or_fails_is_logged_on_request(tmp_path: Path) -> None:
    with RunningService(tmp_path, REVISIT_LOG="json", REVISIT_LOG_LEVEL="warning") as service:
        assert httpx.get(f"{service.url}/maps", timeout=60).status_code == 200
    assert [line for line in lines(service) if line.get("event") == "request"] == []


def test_what_the_worker_says_of_a_job_is_found_by_the_ids_that_the_request_has(tmp_path: Path) -> None:
    with RunningService(tmp_path, False, REVISIT_LOG="json", REVISIT_INLINE_WORKER="false") as service:
        httpx.post(
            f"{service.url}/enroll?wait=false",
            content=photo(),
            headers=JPEG | {"x-request-id": "mine"},
            timeout=60,
        )
    (access,) = [line for line in lines(service) if line.get("request_id") == "mine"]
    for image in (tmp_path / "pictures").rglob("*"):
        if image.is_file():
            image.unlink()
    with RunningService(tmp_path, REVISIT_LOG="json") as service:
        view = f"{service.url}/views/{access['view_ids'][0]}"
        until(lambda: httpx.get(view, timeout=60).json()["state"] == "failed")
    told = [line for line in lines(service) if line["logger"] == "revisit.worker"]
    assert told
    assert {(line.get("job_id"), line.get("view_id")) for line in told} == {
        (access["job_ids"][0], access["view_ids"][0])
    }
