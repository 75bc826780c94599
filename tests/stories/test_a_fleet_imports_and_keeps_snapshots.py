"""A fleet imports recordings and makes snapshots through any node, while workers are killed and the store is away."""

import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests import waiting
from tests.sample_images import photo
from tests.storage.databases import postgres_schema
from tests.storage.object_store import ObjectStore
from tests.stories.importing import ZIP, ended, photos, zipped
from tests.stories.running import RunningService, worker
from worker.storage.snapshot_files import SnapshotReader

pytestmark = pytest.mark.one_database("it has databases of its own")

JPEG = {"content-type": "image/jpeg"}
IMAGES = 80


@pytest.fixture
def objects() -> Iterator[ObjectStore]:
    store = ObjectStore()
    yield store
    store.stop()


@pytest.fixture
def there(objects: ObjectStore) -> Iterator[dict[str, str]]:
    """Variables of every process of the fleet."""
    with postgres_schema() as url:
        yield {
            "REVISIT_DATABASE": url, "REVISIT_LEASE_S": "2", **objects.environment
        }  # fmt: skip


def nodes(stack: ExitStack, tmp_path: Path, there: dict[str, str]) -> list[httpx.Client]:
    """Two query nodes, of which none describes or imports."""
    apart = there | {"REVISIT_INLINE_WORKER": "false"}
    services = [stack.enter_context(RunningService(tmp_path / name, False, **apart)) for name in ("a", "b")]
    return [stack.enter_context(httpx.Client(base_url=service.url, timeout=120)) for service in services]


def until(client: httpx.Client, condition: str, status: int = 200) -> None:
    deadline = time.monotonic() + 60
    while client.get(condition).status_code != status:
        assert time.monotonic() < deadline, condition
        time.sleep(0.05)


def ready(client: httpx.Client, name: str) -> int:
    answer = client.get(f"/maps/{name}")
    return int(answer.json()["views"]["ready"]) if answer.status_code == 200 else 0


def sent(client: httpx.Client, name: str, count: int) -> str:
    answer = client.post(f"/maps/{name}/imports", content=zipped(photos(count, 96)), headers=ZIP)
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def others(objects: ObjectStore) -> list[str]:
    """Names in the bucket that are of no image."""
    return [name for name in objects.names() if name[2:3] != "/" or len(name) != 70] + objects.unfinished()


def left(folder: Path) -> list[Path]:
    """Files of recordings and snapshots in a data folder."""
    found = [path for name in ("imports", "snapshots", "scratch") for path in (folder / name).rglob("*")]
    return [path for path in found if path.name != ".making"]


def test_a_worker_is_killed_in_an_import_and_another_finishes_it(
    tmp_path: Path, there: dict[str, str], objects: ObjectStore
) -> None:
    with ExitStack() as stack:
        a, b = nodes(stack, tmp_path, there)
        with worker(tmp_path / "first", **there) as first:
            until(a, "/readyz")
            until(b, "/readyz")
            job_id = sent(a, "walk", IMAGES)
            assert others(objects) == [f"imports/{job_id}/request.json", f"imports/{job_id}/upload"]
            while (done := ready(b, "walk")) < 10:
                time.sleep(0.02)
            first.kill()
            first.wait()
        assert done < IMAGES, "it was over before the kill"
        state = b.get(f"/jobs/{job_id}").json()["state"]
        assert state in ("running", "waiting")  # until the nodes notice that it is gone
        assert left(tmp_path / "first")  # of which the next worker with this folder rids it

        stack.enter_context(worker(tmp_path / "second", **there))
        job = ended(b, job_id)
        assert (job["state"], job["progress"]) == ("done", {"done": IMAGES, "total": IMAGES})
        assert (job["result"]["enrolled"], job["result"]["already_there"], job["result"]["errors"]) == (IMAGES, 0, [])
        assert a.get("/maps/walk").json()["views"] == {"pending": 0, "ready": IMAGES, "failed": 0}
        waiting.until(lambda: not others(objects))  # it is removed right after the job has ended
        assert (others(objects), len(objects.names())) == ([], IMAGES)
        assert [left(tmp_path / name) for name in ("a", "b", "second")] == [[], [], []]
        with worker(tmp_path / "first", **there):
            assert left(tmp_path / "first") == []


def test_what_ends_an_import_leaves_nothing_of_it(tmp_path: Path, there: dict[str, str], objects: ObjectStore) -> None:
    with ExitStack() as stack:
        a, b = nodes(stack, tmp_path, there)
        stack.enter_context(worker(tmp_path / "worker", **there))
        until(a, "/readyz")
        until(b, "/readyz")
        for end in ("/jobs/{}", "/maps/walk"):
            job_id = sent(a, "walk", IMAGES)
            waiting = sent(a, "walk", 3)
            while ready(b, "walk") < 5:
                time.sleep(0.02)
            assert b.delete(end.format(job_id)).status_code == 200
            assert not [name for name in others(objects) if job_id in name]
            if end == "/maps/walk":
                assert others(objects) == []
            else:
                assert ended(b, job_id)["state"] == "cancelled"
                assert ended(a, waiting)["state"] == "done"
        refused = a.post("/maps/walk/imports", content=b"no archive", headers=ZIP)
        assert (refused.status_code, others(objects), left(tmp_path / "a")) == (400, [], [])
        assert ended(b, sent(a, "after", 2))["state"] == "done"
        assert left(tmp_path / "worker") == []


def test_a_snapshot_made_through_one_node_is_downloaded_and_restored_through_another(
    tmp_path: Path, there: dict[str, str], objects: ObjectStore
) -> None:
    with ExitStack() as stack:
        a, b = nodes(stack, tmp_path, there)
        stack.enter_context(worker(tmp_path / "worker", **there))
        until(a, "/readyz")
        until(b, "/readyz")
        ended(a, sent(a, "walk", 40))
        job = ended(a, a.post("/maps/walk/snapshots").json()["id"])
        assert (job["state"], job["result"]["views"]) == ("done", 40)

        [listed] = b.get("/snapshots").json()["snapshots"]
        answer = b.get(f"/snapshots/{job['id']}")
        assert int(answer.headers["content-length"]) == listed["bytes"] == len(answer.content) == job["result"]["bytes"]
        assert answer.headers["content-disposition"].endswith('.snapshot"')
        assert answer.headers["content-type"] == "application/x-tar"
        assert a.get(f"/snapshots/{job['id']}").content == answer.content
        rest = a.get(f"/snapshots/{job['id']}", headers={"range": "bytes=5000-", "if-range": answer.headers["etag"]})
        assert (rest.status_code, rest.content == answer.content[5000:]) == (206, True)
        copy = tmp_path / "copy"
        copy.write_bytes(answer.content)
        assert sum(part.name.startswith("images/") for part in SnapshotReader(copy).verified()) == 40

        restored = b.post("/restore", params={"as": "copy"}, content=answer.content)
        assert (restored.status_code, restored.json()["views"]) == (201, 40)
        found: list[Any] = [
            [(match["score"], match["view"]["filename"]) for match in answered.json()["matches"]]
            for name in ("walk", "copy")
            for answered in [a.post(f"/query?map={name}", content=photo(3), headers=JPEG)]
        ]
        assert found[0] == found[1]

        receipt = a.delete("/maps/walk").json()
        assert [(one["id"], one["views"]) for one in receipt["snapshots"]] == [(job["id"], 40)]
        assert b.delete(f"/snapshots/{job['id']}").json()["id"] == job["id"]
        assert a.get(f"/snapshots/{job['id']}").status_code == 404
        assert (others(objects), len(objects.names())) == ([], 40)
        assert [left(tmp_path / name) for name in ("a", "b", "worker")] == [[], [], []]


def test_an_import_waits_while_the_object_store_is_away(
    tmp_path: Path, there: dict[str, str], objects: ObjectStore
) -> None:
    with ExitStack() as stack:
        [a, b] = nodes(stack, tmp_path, there)
        stack.enter_context(worker(tmp_path / "worker", **there))
        until(a, "/readyz")
        until(b, "/readyz")
        ended(a, sent(a, "before", 3))
        job_id = sent(a, "walk", IMAGES)
        while ready(b, "walk") < 10:
            time.sleep(0.02)
        objects.stop()
        until(a, "/readyz", 503)
        while b.get(f"/jobs/{job_id}").json()["state"] != "waiting":
            time.sleep(0.05)
        refused = a.post("/maps/other/imports", content=zipped(photos(2)), headers=ZIP)
        assert (refused.status_code, refused.json()["type"]) == (503, "urn:revisit:problem:unavailable")
        assert "cannot be reached" in refused.json()["detail"]
        assert (a.get("/maps/other").status_code, left(tmp_path / "a")) == (404, [])
        behind = a.post("/maps/before/snapshots").json()["id"]

        objects.start()
        until(a, "/readyz")
        job = ended(b, job_id)
        assert (job["state"], job["result"]["enrolled"], job["result"]["errors"]) == ("done", IMAGES, [])
        assert ended(a, behind)["state"] == "done"

        objects.stop()
        made = ended(a, a.post("/maps/before/snapshots").json()["id"])
        assert made["state"] == "failed"
        assert "try again in a moment" in made["failure"]["detail"]
        until(b, f"/snapshots/{behind}", 503)
        objects.start()
        until(b, f"/snapshots/{behind}")
        names = [name for name in others(objects) if not name.startswith("snapshots/")]
        assert names == []
