"""The same service with its rows in PostgreSQL: killed, and through a database server that goes away and comes back."""

import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import psycopg
import pytest
import sqlalchemy as sa

from tests.sample_images import photo
from tests.storage.databases import PostgresServer, postgres_schema
from tests.stories.importing import ZIP, ended, zipped
from tests.stories.running import RunningService, worker
from tests.stories.test_a_database_fails_over import USER
from tests.waiting import PATIENCE_S, until
from worker.storage.retrying import PAUSES_S

pytestmark = pytest.mark.one_database("it has databases of its own")

JPEG = {"content-type": "image/jpeg"}


@pytest.fixture
def server() -> Iterator[PostgresServer]:
    with tempfile.TemporaryDirectory(prefix="revisit-postgresql-") as folder, PostgresServer(Path(folder)) as running:
        yield running


def found(client: httpx.Client, number: int) -> Any:
    answer = client.post("/query", content=photo(number), headers=JPEG).json()
    return [(match["view"]["id"], match["score"]) for match in answer["matches"]]


def until_ready(client: httpx.Client) -> float:
    began = time.monotonic()
    while client.get("/readyz").status_code != 200:
        assert time.monotonic() - began < PATIENCE_S
        time.sleep(0.05)
    return time.monotonic() - began


def test_what_was_acknowledged_is_there_after_a_kill_and_a_worker_apart_describes(tmp_path: Path) -> None:
    with postgres_schema() as url:
        there = {"REVISIT_DATABASE": url, "REVISIT_LEASE_S": "2"}
        with RunningService(tmp_path, **there) as service, httpx.Client(base_url=service.url, timeout=40) as client:
            kept = [client.post("/enroll", content=photo(n), headers=JPEG).json()["view"]["id"] for n in range(4)]
            before = found(client, 2)
            service.kill()
        with (
            RunningService(tmp_path, False, **there, REVISIT_INLINE_WORKER="false") as service,
            worker(tmp_path, **there),
            httpx.Client(base_url=service.url, timeout=40) as client,
        ):
            until_ready(client)
            assert found(client, 2) == before
            assert client.post("/enroll", content=photo(4), headers=JPEG).status_code == 201
            assert len(client.get("/views").json()["views"]) == 5
            assert client.delete(f"/views/{kept[0]}").status_code == 200
        assert not (tmp_path / "revisit.db").exists()


def test_while_the_database_server_is_away_callers_are_told_and_then_served(
    tmp_path: Path, server: PostgresServer
) -> None:
    with (
        RunningService(tmp_path, REVISIT_DATABASE=server.url) as service,
        httpx.Client(base_url=service.url, timeout=40) as client,
    ):
        kept = client.post("/enroll", content=photo(1), headers=JPEG).json()["view"]["id"]
        before = found(client, 1)

        server.stop()
        calls = [
            ("GET", "/views"),
            ("GET", "/maps"),
            ("DELETE", f"/views/{kept}"),
            ("POST", "/query"),
            ("POST", "/enroll"),
        ]
        for method, path in calls:
            sent: dict[str, Any] = {"content": photo(2), "headers": JPEG} if method == "POST" else {}
            refused = client.request(method, path, **sent)
            assert (refused.status_code, refused.json()["type"]) == (503, "urn:revisit:problem:unavailable"), path
            assert "database server" in refused.json()["detail"]
            assert int(refused.headers["retry-after"]) > 0
        until(lambda: client.get("/readyz").status_code != 200)
        assert "database server" in client.get("/readyz").json()["checks"]["database"]
        assert client.get("/livez").status_code == 200

        server.start()
        until_ready(client)
        assert found(client, 1) == before
        assert client.post("/enroll", content=photo(2), headers=JPEG).status_code == 201
        assert "Traceback" not in "".join(service.output)


def test_a_job_goes_on_after_the_database_server_was_away(tmp_path: Path, server: PostgresServer) -> None:
    """For longer than the worker tries to put it back: it would be nobody's then, and seem to run for ever."""
    with (
        RunningService(tmp_path, REVISIT_DATABASE=server.url) as service,
        httpx.Client(base_url=service.url, timeout=40) as client,
    ):
        body = zipped({f"{number}.jpg": photo(number) for number in range(60)})
        job = client.post("/maps/walk/imports", content=body, headers=ZIP).json()["id"]
        until(lambda: (client.get(f"/jobs/{job}").json()["progress"] or {"done": 0})["done"] > 0)
        server.stop()
        time.sleep(3 * sum(PAUSES_S))
        server.start()
        until_ready(client)
        told = ended(client, job)
        assert (told["state"], told["result"]["enrolled"]) == ("done", 60)


def test_a_server_that_becomes_a_standby_is_told_and_written_again_once_promoted(
    tmp_path: Path, server: PostgresServer
) -> None:
    folder = Path(str(sa.make_url(server.url).query["host"]))
    with (
        RunningService(tmp_path, REVISIT_DATABASE=server.url, REVISIT_LEASE_S="2") as service,
        httpx.Client(base_url=service.url, timeout=40) as client,
    ):
        assert client.post("/enroll", content=photo(1), headers=JPEG).status_code == 201
        before = found(client, 1)
        server.stop()
        (folder / "standby.signal").touch()
        if USER is not None:
            shutil.chown(folder / "standby.signal", USER)
        server.start()
        refused = client.post("/enroll", content=photo(2), headers=JPEG)
        assert (refused.status_code, refused.json()["type"]) == (503, "urn:revisit:problem:unavailable")
        assert "standby" in refused.json()["detail"]
        until(lambda: client.get("/readyz").status_code == 503)
        assert found(client, 1) == before
        with psycopg.connect(server.url) as connection:
            connection.execute("SELECT pg_promote()")
        until_ready(client)
        assert client.post("/enroll", content=photo(2), headers=JPEG).status_code == 201
        assert "Traceback" not in "".join(service.output)
