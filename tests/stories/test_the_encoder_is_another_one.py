"""A service starts with another encoder: maps of the one before say so, are described anew, and go back at once."""

import time
from pathlib import Path
from typing import Any

import httpx

from scenes import scene
from tests.stories.importing import ZIP, ended, photos, zipped
from tests.stories.photos import photo
from tests.stories.running import RunningService, worker
from tests.waiting import until

JPEG = {"content-type": "image/jpeg"}
PLACES = ("mill lane", "rose garden", "castle park")


def places(client: httpx.Client) -> list[Any]:
    """The first place of each answer and its score, or the problem of a refusal."""
    found: list[Any] = []
    for name in PLACES:
        answer = client.post("/query", content=photo(scene(name).seen_from(dx=0.2)), headers=JPEG)
        told = answer.json()
        first = told["matches"][0] if answer.status_code == 200 else None
        found.append((first["view"]["place"], first["score"]) if first else (answer.status_code, told["type"]))
    return found


def describe_anew(client: httpx.Client) -> None:
    begun = client.post("/maps/default/recipe", json={})
    assert begun.status_code == 202, begun.text
    assert ended(client, begun.json()["id"])["state"] == "done"


def test_a_map_is_carried_over_to_another_encoder_and_back(tmp_path: Path) -> None:
    refused = [(409, "urn:revisit:problem:conflict")] * len(PLACES)
    quiet = {"REVISIT_COMPARE": "false"}
    with RunningService(tmp_path, **quiet) as service, httpx.Client(base_url=service.url, timeout=60) as client:
        for name in PLACES:
            sent = client.post(f"/enroll?place={name}", content=photo(scene(name)), headers=JPEG)
            assert sent.status_code == 201
        before = places(client)

    compact = {**quiet, "REVISIT_ENCODER": "compact"}
    with RunningService(tmp_path, **compact) as service, httpx.Client(base_url=service.url, timeout=60) as client:
        assert places(client) == refused
        told = client.post("/query", content=photo(scene(PLACES[0])), headers=JPEG).json()["detail"]
        assert "needs the encoder color" in told
        assert "running is compact" in told
        for wait in ("true", "false"):
            sent = client.post(f"/enroll?wait={wait}", content=photo(scene("quay")), headers=JPEG)
            assert (sent.status_code, sent.json()["type"]) == refused[0]
        training = client.post("/maps/default/vocabulary")
        assert (training.status_code, training.json()["type"]) == refused[0]
        recording = client.post("/maps/default/imports", content=zipped(photos(2)), headers=ZIP)
        assert (recording.status_code, recording.json()["type"]) == refused[0]
        assert client.get("/maps/default").json()["views"] == {"pending": 0, "ready": len(PLACES), "failed": 0}
        describe_anew(client)
        new = client.post("/enroll?place=quay", content=photo(scene("quay")), headers=JPEG)
        assert (new.status_code, client.delete(f"/views/{new.json()['view']['id']}").status_code) == (201, 200)
        assert [place for place, _ in places(client)] == list(PLACES)
        assert client.get("/maps/default").json()["recipe"]["encoder"] == "compact"

    with RunningService(tmp_path, **quiet) as service, httpx.Client(base_url=service.url, timeout=60) as client:
        assert places(client) == refused
        describe_anew(client)  # from the descriptions that were kept for the way back
        assert places(client) == before


def test_a_worker_with_another_encoder_leaves_the_photos_to_one_that_can_describe_them(tmp_path: Path) -> None:
    """As in a fleet that is brought to new weights node by node, or where one machine has other settings."""
    with (
        RunningService(tmp_path, False, REVISIT_INLINE_WORKER="false") as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):

        def views() -> dict[str, int]:
            counts: dict[str, int] = client.get("/maps/default").json()["views"]
            return counts

        def nobody(*, answers_for: str) -> str | None:
            checked: str = client.get("/readyz").json()["checks"]["worker"]
            return checked if answers_for in checked else None

        assert until(lambda: nobody(answers_for="`./revisit worker`"))
        with worker(tmp_path, REVISIT_ENCODER="compact"):
            for name in PLACES:
                kept = client.post(f"/enroll?wait=false&place={name}", content=photo(scene(name)), headers=JPEG)
                assert kept.status_code == 202
            told = until(lambda: nobody(answers_for="only by compact"))
            assert "describes by color" in told
            hasty = client.post("/enroll", content=photo(scene("quay")), headers=JPEG)
            assert (hasty.status_code, hasty.json()["detail"].startswith(told)) == (503, True)
            time.sleep(2)
            assert views() == {"pending": len(PLACES), "ready": 0, "failed": 0}
        with worker(tmp_path):
            until(lambda: nobody(answers_for="ok"))
            until(lambda: views() == {"pending": 0, "ready": len(PLACES), "failed": 0})


def test_photos_that_wait_for_an_encoder_that_is_gone_are_described_by_the_one_that_there_is(tmp_path: Path) -> None:
    with (
        RunningService(tmp_path, False, REVISIT_INLINE_WORKER="false") as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):
        for name in PLACES:
            kept = client.post(f"/enroll?wait=false&place={name}", content=photo(scene(name)), headers=JPEG)
            assert kept.status_code == 202
    with (
        RunningService(tmp_path, REVISIT_ENCODER="compact") as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):
        assert client.get("/maps/default").json()["views"]["pending"] == len(PLACES)
        describe_anew(client)
        assert [place for place, _ in places(client)] == list(PLACES)
        assert client.get("/jobs?state=waiting").json()["jobs"] == []
