"""`/readyz` tries what it says: the encoder with an image, the worker, the disk, the index of each map."""

import statistics
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from app.http.application import create_app
from app.http.readiness import ReadinessCheck
from schemas.errors import DiskFull, SetupError
from tests.openapi import CheckedClient
from tests.sample_images import photo
from tests.stories.running import settings
from tests.waiting import PATIENCE_S, until as soon
from worker.description.describers import Describers
from worker.encoders.color import ColorEncoder
from worker.runtime import Runtime, build

JPEG = {"content-type": "image/jpeg"}
ANSWER_S, PROBES = 0.5, 3


@pytest.fixture
def runtime(tmp_path: Path) -> Runtime:
    return build(settings(tmp_path))


@pytest.fixture
def client(runtime: Runtime, monkeypatch: pytest.MonkeyPatch) -> Iterator[CheckedClient]:
    """A service whose every probe makes a check of its own."""
    monkeypatch.setattr("app.http.readiness.FRESH_S", 0.0)
    monkeypatch.setattr("app.http.readiness.ENCODER_PATIENCE_S", 1.0)
    with CheckedClient(create_app(runtime)) as client:
        yield client


def until(client: CheckedClient, ready: bool) -> Any:
    """The first answer that says so. Most probes are in time: a crowded machine may stop any single one."""
    took: list[float] = []

    def probe() -> Any:
        began = time.monotonic()
        answer = client.get("/readyz")
        took.append(time.monotonic() - began)
        assert answer.status_code == (200 if answer.json()["ready"] else 503)
        return answer.json()

    deadline = time.monotonic() + PATIENCE_S
    while (answer := probe())["ready"] is not ready:
        assert time.monotonic() < deadline, f"still {answer}"
        time.sleep(0.02)
    while len(took) < PROBES:
        probe()
    assert statistics.median(took) < ANSWER_S
    return answer


def test_each_map_is_named_with_the_revision_of_its_index(client: CheckedClient) -> None:
    assert client.post("/enroll?map=quay", content=photo(1), headers=JPEG).status_code == 201
    before = until(client, True)["maps"]["quay"]
    assert (before["state"], before["indexed"] in (None, before["revision"])) == ("ok", True)
    assert client.post("/query?map=quay", content=photo(1), headers=JPEG).status_code == 200
    assert client.post("/enroll?map=quay", content=photo(2), headers=JPEG).status_code == 201
    after = until(client, True)["maps"]["quay"]
    assert after["revision"] > before["revision"]
    assert after["indexed"] is not None


def test_an_encoder_that_hangs_is_found_out_within_half_a_second_for_every_probe(
    client: CheckedClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    until(client, True)
    go = threading.Event()
    encode = ColorEncoder.encode
    monkeypatch.setattr(
        ColorEncoder, "encode", lambda self, images, **how: (go.wait(30), encode(self, images, **how))[1]
    )
    assert "no image" in until(client, False)["checks"]["encoder"]
    go.set()
    assert until(client, True)["checks"]["encoder"] == "ok"


def test_an_encoder_that_fails_is_found_out_although_nobody_queries(
    client: CheckedClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    until(client, True)

    def fail(*_: object, **__: object) -> Any:
        raise RuntimeError("out of memory")

    with monkeypatch.context() as broken:
        broken.setattr(ColorEncoder, "encode", fail)
        assert "RuntimeError" in until(client, False)["checks"]["encoder"]
    until(client, True)


def test_photos_wait_for_an_encoder_that_fails_and_a_supervisor_is_told_to_restart_it(
    client: CheckedClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("worker.description.scheduler.HOPELESS_S", 0.2)
    monkeypatch.setattr("worker.description.blame.REST_S", 0)
    assert client.post("/enroll?map=quay", content=photo(1), headers=JPEG).status_code == 201

    def fail(*_: object, **__: object) -> Any:
        raise RuntimeError("CUDA error: an illegal memory access was encountered")

    with monkeypatch.context() as broken:
        broken.setattr(ColorEncoder, "encode", fail)
        later = client.post("/enroll?map=quay&wait=0", content=photo(2), headers=JPEG)
        assert later.status_code == 202
        refused = client.post("/query?map=quay", content=photo(1), headers=JPEG)
        assert (refused.status_code, refused.headers["retry-after"]) == (503, "0")
        assert "fails on every image (RuntimeError)" in refused.json()["detail"]
        assert "fails on every image" in until(client, False)["checks"]["encoder"]
        soon(lambda: client.get("/livez").status_code == 503)
        assert "the encoder has failed on every image for" in client.get("/livez").text
        assert client.get("/maps/quay").json()["views"] == {"ready": 1, "pending": 1, "failed": 0}

    soon(lambda: client.get("/maps/quay").json()["views"]["ready"] == 2)
    assert client.get("/livez").text == "ok\n"


def test_a_service_whose_worker_has_ended_is_to_be_restarted(runtime: Runtime, client: CheckedClient) -> None:
    assert client.get("/livez").status_code == 200
    assert runtime.loop is not None
    runtime.loop.stop()  # as an error would that nobody foresaw

    answer = client.get("/livez")

    assert (answer.status_code, answer.text) == (503, "a thread of the worker has ended; restart it\n")
    assert answer.headers["content-type"].startswith("text/plain")


def test_a_service_too_busy_to_look_in_time_gives_its_last_result(
    runtime: Runtime, client: CheckedClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    until(client, True)
    current, check = ReadinessCheck.current, runtime.store.check
    looks: list[ReadinessCheck] = []

    async def late(self: ReadinessCheck) -> Any:
        looks.append(self)
        time.sleep(ANSWER_S)  # the event loop does nothing else meanwhile
        return await current(self)

    def slow() -> str:
        time.sleep(ANSWER_S)
        return check()

    monkeypatch.setattr(ReadinessCheck, "current", late)
    monkeypatch.setattr(runtime.store, "check", slow)

    answer = client.get("/readyz")

    assert (answer.status_code, answer.json()["checks"]["database"]) == (200, "ok")
    assert answer.json()["age_s"] > 0
    running = looks[0]._running
    assert running is not None
    running.result(20)  # it reads the database, which is closed now


def test_the_first_probe_of_a_service_that_is_busy_since_it_started_finds_it_ready(
    runtime: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is looked at when it has started: the check of a first probe would have to wait behind the work."""
    monkeypatch.setattr("app.http.readiness.FRESH_S", 0.0)
    looked = threading.Event()
    look = ReadinessCheck._check

    def check(self: ReadinessCheck) -> Any:
        found = look(self)
        looked.set()
        return found

    monkeypatch.setattr(ReadinessCheck, "_check", check)
    with CheckedClient(create_app(runtime)) as client:
        assert looked.wait(PATIENCE_S)
        monkeypatch.setattr(runtime.store, "check", lambda: time.sleep(ANSWER_S))
        answer = client.get("/readyz")
    assert (answer.status_code, answer.json()["checks"]["encoder"]) == (200, "ok")


def test_what_was_wrong_some_time_ago_is_looked_at_again_before_it_is_told(
    runtime: Runtime, client: CheckedClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A page that asks now and then is not shown the trouble of half a minute ago."""
    until(client, True)
    with monkeypatch.context() as meanwhile:
        meanwhile.setattr(runtime.store, "check", lambda: "the disk does not answer")
        until(client, False)
    monkeypatch.setattr("app.http.readiness.PATIENCE_S", 0.0)
    monkeypatch.setattr("app.http.readiness.BAD_PATIENCE_S", PATIENCE_S)
    assert client.get("/readyz").status_code == 200


def test_it_is_not_ready_while_the_table_of_views_cannot_be_read(runtime: Runtime, client: CheckedClient) -> None:
    """Its clock and its maps are read each time; without views there is nothing to enrol into or to find."""
    until(client, True)
    rename = "ALTER TABLE {} RENAME TO {}"
    with runtime.store._database.engine.begin() as connection:
        connection.execute(sa.text(rename.format("views", "views_elsewhere")))
    assert "views" in until(client, False)["checks"]["database"]
    with runtime.store._database.engine.begin() as connection:
        connection.execute(sa.text(rename.format("views_elsewhere", "views")))
    assert until(client, True)["checks"]["database"] == "ok"


def test_it_is_not_ready_while_callers_are_refused_because_descriptions_could_not_be_stored(
    runtime: Runtime, client: CheckedClient
) -> None:
    settlements = runtime.settlements
    settlements.refuse(DiskFull("no room for descriptions"))
    assert until(client, False)["checks"]["disk"] == "no room for descriptions"
    assert client.post("/enroll", content=photo(1), headers=JPEG).status_code == 507
    settlements.refuse(None)
    assert until(client, True)["checks"]["disk"] == "ok"
    assert client.post("/enroll", content=photo(1), headers=JPEG).status_code == 201


def test_it_stays_ready_when_a_file_is_refused_for_which_no_disk_has_room(client: CheckedClient) -> None:
    until(client, True)
    announced = {"content-type": "application/x-tar", "content-length": str(10**15)}

    refused = client.post("/restore", content=b"x", headers=announced)

    assert refused.status_code == 507
    assert "has no room for 1000000000.0 MB more" in refused.json()["detail"]
    for _ in range(3):
        assert client.get("/readyz").json()["checks"]["disk"] == "ok"
    assert client.post("/enroll", content=photo(1), headers=JPEG).status_code == 201


def test_a_map_that_cannot_be_served_is_named_and_the_others_are_served(
    client: CheckedClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("good", "broken"):
        client.post(f"/enroll?map={name}", content=photo(1), headers=JPEG)
    client.put("/maps/broken2", json={"preset": "paper"})
    found = Describers.of

    def of(self: Describers, recipe: Any) -> Any:
        if recipe.parameters.channels.keys() == {"semantic"} or "paper" in str(recipe.id):
            raise SetupError("its vocabulary is lost")
        return found(self, recipe)

    monkeypatch.setattr(Describers, "of", of)
    readiness = until(client, True)
    assert readiness["maps"]["broken2"]["state"] == "its vocabulary is lost"
    assert readiness["checks"]["map broken2"] == "its vocabulary is lost"
    assert readiness["maps"]["good"]["state"] == "ok"
    assert client.post("/query?map=good", content=photo(1), headers=JPEG).status_code == 200
