"""Two query nodes and workers apart, each with its own data folder, on one PostgreSQL and one S3-compatible store."""

import signal
import statistics
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.sample_images import photo
from tests.storage.databases import postgres_schema
from tests.storage.object_store import ObjectStore
from tests.stories.running import RunningService, worker
from tests.waiting import until

pytestmark = pytest.mark.one_database("it has databases of its own")

JPEG = {"content-type": "image/jpeg"}
LEASE_S = 2.0


@pytest.fixture
def there() -> Iterator[dict[str, str]]:
    """Variables of every process of the fleet."""
    objects = ObjectStore()
    with postgres_schema() as url:
        yield {"REVISIT_DATABASE": url, "REVISIT_LEASE_S": str(LEASE_S), **objects.environment}
    objects.stop()


def nodes(stack: ExitStack, tmp_path: Path, there: dict[str, str]) -> list[httpx.Client]:
    """Two query nodes, of which none describes."""
    apart = there | {"REVISIT_INLINE_WORKER": "false"}
    services = [stack.enter_context(RunningService(tmp_path / name, False, **apart)) for name in ("a", "b")]
    return [stack.enter_context(httpx.Client(base_url=service.url, timeout=60)) for service in services]


def until_ready(*clients: httpx.Client) -> None:
    for client in clients:
        until(lambda client=client: client.get("/readyz").status_code == 200)  # type: ignore[misc]


def enrolled(client: httpx.Client, number: int) -> str:
    answer = client.post("/enroll", content=photo(number), headers=JPEG)
    assert answer.status_code == 201, answer.text
    return str(answer.json()["view"]["id"])


def later(client: httpx.Client, number: int) -> str:
    """Enrol without waiting for the description."""
    answer = client.post("/enroll", params={"wait": "false"}, content=photo(number), headers=JPEG)
    return str(answer.json()["view"]["id"])


def states(client: httpx.Client, views: list[str]) -> list[str]:
    return [client.get(f"/views/{view}").json()["state"] for view in views]


def found(client: httpx.Client, number: int) -> list[str]:
    answer: Any = client.post("/query", content=photo(number), headers=JPEG)
    assert answer.status_code == 200, answer.text
    return [match["view"]["id"] for match in answer.json()["matches"]]


def test_what_one_node_acknowledges_the_other_knows_at_once(tmp_path: Path, there: dict[str, str]) -> None:
    with ExitStack() as stack:
        a, b = nodes(stack, tmp_path, there)
        stack.enter_context(worker(tmp_path / "worker", **there))
        until_ready(a, b)
        kept = enrolled(a, 0)
        behind = []
        for number in range(1, 9):
            view = enrolled(a, number)
            began = time.monotonic()
            assert found(b, number)[0] == view  # the first query after the acknowledgement
            behind.append(time.monotonic() - began)
            assert b.get(f"/views/{view}/image").content == photo(number)

            answers: list[list[str]] = []
            deleted = threading.Event()
            late: list[list[str]] = []

            def ask_in_a_loop(
                number: int = number,
                answers: list[list[str]] = answers,
                deleted: threading.Event = deleted,
                late: list[list[str]] = late,
            ) -> None:
                for _ in range(12):
                    after = deleted.is_set()
                    answers.append(found(b, number))
                    if after:
                        late.append(answers[-1])

            asking = threading.Thread(target=ask_in_a_loop)
            asking.start()
            assert a.delete(f"/views/{view}").status_code == 200
            deleted.set()
            asking.join()
            late.append(found(b, number))
            assert len(answers) == 12
            assert all(view not in ids for ids in late)
            assert b.get(f"/views/{view}/image").status_code == 404
        again = []
        for _ in range(8):  # nothing changed meanwhile
            began = time.monotonic()
            assert found(b, 0)[0] == kept
            again.append(time.monotonic() - began)
        print(f"query after a change {1000 * statistics.median(behind):.1f} ms, without one "
              f"{1000 * statistics.median(again):.1f} ms")  # fmt: skip


def test_a_worker_that_is_killed_is_followed_by_another_within_seconds(tmp_path: Path, there: dict[str, str]) -> None:
    with ExitStack() as stack:
        a, b = nodes(stack, tmp_path, there)
        with worker(tmp_path / "first", **there) as first:
            until_ready(a, b)
            sent = [later(a, n) for n in range(20)]
            first.send_signal(signal.SIGSTOP)  # what it has claimed stays claimed
            sent += [later(a, n) for n in range(20, 40)]
            first.kill()
            first.wait()
        began = time.monotonic()
        assert states(b, sent).count("pending") >= 20
        stack.enter_context(worker(tmp_path / "second", **there))
        while set(left := states(b, sent)) != {"ready"}:
            assert time.monotonic() - began < 15 * LEASE_S, left
        print(f"all described {time.monotonic() - began:.1f} s after the kill, the second worker's start included")
        assert found(b, 39)[0] == sent[39]


def test_nodes_that_describe_too_share_the_work_and_take_over_from_one_that_dies(
    tmp_path: Path, there: dict[str, str]
) -> None:
    """As they come, without `REVISIT_INLINE_WORKER=false`: neither takes the other for a dead predecessor."""
    with ExitStack() as stack:
        comparing = {**there, "REVISIT_COMPARE": "true"}
        services = [stack.enter_context(RunningService(tmp_path / name, True, **comparing)) for name in ("a", "b")]
        a, b = (stack.enter_context(httpx.Client(base_url=service.url, timeout=60)) for service in services)
        for number in range(10):  # over many rounds of signs of life
            enrolled(a if number % 2 else b, number)
            time.sleep(LEASE_S / 4)
        assert [line for service in services for line in service.output if "workers are gone" in line] == []
        services[0].signal(signal.SIGSTOP)  # what it has claimed stays claimed
        sent = [later(b, number) for number in range(10, 40)]
        services[0].kill()
        began = time.monotonic()
        while set(left := states(b, sent)) != {"ready"}:
            assert time.monotonic() - began < 15 * LEASE_S, left
        assert found(b, 39)[0] == sent[39 - 10]
