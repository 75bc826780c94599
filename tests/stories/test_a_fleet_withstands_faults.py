"""Faults of a fleet, with real processes: nodes killed, slow and cut off, the database restarted, two writing one map.

Nothing that was acknowledged is lost, and no node answers with a view that was deleted before the question.
"""

import os
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import httpx
import pytest

from tests.sample_images import photo
from tests.storage.databases import PostgresServer
from tests.storage.object_store import ObjectStore
from tests.stories.fleets import JPEG, Ledger, found, nodes, until
from tests.stories.running import ROOT, RunningService, worker
from worker.storage.retrying import JITTER, PAUSES_S

pytestmark = pytest.mark.one_database("it has databases of its own")

LEASE_S = "2"

AWAY_S = 2 * sum(PAUSES_S) * (1 + JITTER)
"""Longer than a transaction is run again: callers must be told."""


@pytest.fixture
def objects() -> Iterator[ObjectStore]:
    store = ObjectStore()
    yield store
    store.stop()


@pytest.fixture
def server() -> Iterator[PostgresServer]:
    with tempfile.TemporaryDirectory(prefix="revisit-postgresql-") as folder, PostgresServer(Path(folder)) as running:
        yield running


@pytest.fixture
def there(objects: ObjectStore, server: PostgresServer) -> dict[str, str]:
    """Variables of every process of the fleet."""
    return {
        "REVISIT_DATABASE": server.url, "REVISIT_LEASE_S": LEASE_S, "REVISIT_COMPARE": "false", "REVISIT_WAIT": "20",
        **objects.environment,
    }  # fmt: skip


def together(works: Sequence[Callable[[], None]]) -> list[threading.Thread]:
    """Threads that do all of this at once, started."""
    threads = [threading.Thread(target=work) for work in works]
    for thread in threads:
        thread.start()
    return threads


def writing(ledger: Ledger, mine: httpx.Client, other: httpx.Client, numbers: range) -> Callable[[], None]:
    """Enrols at one node and queries at the other; then deletes every third and queries at the other again."""

    def work() -> None:
        for number in numbers:
            view = ledger.enroll(mine, number)
            if view is None:
                time.sleep(0.2)
                continue
            if number % 3 == 0:
                gone = ledger.delete(mine, number)
                if gone is not None:
                    ledger.expect(other, number, gone=gone)
            elif ledger.is_ready(mine, view):
                ledger.expect(other, number, there=view)

    return work


def described(client: httpx.Client, ledger: Ledger, within_s: float = 60) -> None:
    """Wait until nothing waits to be described, then compare all with what was acknowledged."""
    deadline = time.monotonic() + within_s
    while (counts := client.get("/maps/default").json()["views"])["pending"]:
        assert time.monotonic() < deadline, counts
        time.sleep(0.1)
    assert counts["failed"] == 0
    ledger.compare(client)


def test_two_nodes_write_one_map_while_the_database_restarts(
    tmp_path: Path, there: dict[str, str], server: PostgresServer
) -> None:
    ledger = Ledger()
    with ExitStack() as stack:
        (_, a), (_, b) = nodes(stack, tmp_path, there)
        stack.enter_context(worker(tmp_path / "worker", **there))
        until(a)
        until(b)
        works = [
            writing(ledger, mine, other, range(100 * n, 100 * n + 24))
            for n, (mine, other) in enumerate(((a, b), (b, a), (a, b), (b, a)))
        ]
        threads = together(works)
        while len(ledger.kept) < 10:
            time.sleep(0.02)
        server.stop()
        time.sleep(AWAY_S)
        server.start()
        for thread in threads:
            thread.join(180)
        until(a)
        until(b)
        assert ledger.outcomes["201"] > 40
        assert ledger.outcomes["503"] > 0, "nobody noticed that it was away"
        assert ledger.outcomes["query"] > 5
        for client in (a, b):
            described(client, ledger)
        print(f"outcomes {dict(ledger.outcomes)}, the longest call {ledger.longest_s:.1f} s")


def test_a_node_is_killed_and_callers_go_on_with_the_other(tmp_path: Path, there: dict[str, str]) -> None:
    ledger = Ledger()
    with ExitStack() as stack:
        (_, a), (killed, b) = nodes(stack, tmp_path, there)
        stack.enter_context(worker(tmp_path / "worker", **there))
        until(a)
        until(b)
        threads = together([writing(ledger, b, a, range(30)), writing(ledger, a, a, range(100, 130))])
        while len(ledger.kept) < 8:
            time.sleep(0.02)
        killed.kill()
        for thread in threads:
            thread.join(180)
        assert ledger.outcomes["broken off"] > 0
        assert ledger.outcomes["201"] >= 30
        described(a, ledger)

        [(_, again)] = nodes(stack, tmp_path, there, "b")  # with the data folder of the one that was killed
        until(again)
        described(again, ledger)
        for number, view in list(ledger.kept.items())[:5]:
            ledger.expect(again, number, there=view)
        assert ledger.wrong == []


def test_a_node_that_stands_still_holds_nobody_up_and_wakes_without_what_was_deleted(
    tmp_path: Path, there: dict[str, str]
) -> None:
    ledger = Ledger()
    with ExitStack() as stack:
        (_, a), (slow, b) = nodes(stack, tmp_path, there)
        stack.enter_context(worker(tmp_path / "worker", **there))
        until(a)
        until(b)
        for number in range(6):
            ledger.enroll(a, number)
        assert found(b, 0)  # its index has them all
        busy = together([writing(ledger, b, b, range(100, 130))])
        while not any(number >= 100 for number in ledger.kept):
            time.sleep(0.02)
        slow.signal(signal.SIGSTOP)  # perhaps within a transaction, with a lock that others want
        of_a = Ledger()
        began = time.monotonic()
        for number in range(200, 206):
            of_a.enroll(a, number)
        gone = ledger.delete(a, 3)
        stood_s = time.monotonic() - began
        slow.signal(signal.SIGCONT)
        assert gone is not None
        ledger.expect(b, 3, gone=gone)
        busy[0].join(180)
        assert len(of_a.kept) == 6
        assert stood_s < 40, "the server ends a silent transaction after 10 s"
        ledger.kept.update(of_a.kept)
        described(b, ledger)
        print(f"seven writes beside a node that stood still: {stood_s:.1f} s")


# a partition


class Bridge:
    """Carries TCP from an address of its own to a server of this machine, by its port or its socket file."""

    def __init__(self, host: str, to: int | str) -> None:
        self._to = to
        self._listening = socket.create_server((host, 0))
        self.port = int(self._listening.getsockname()[1])
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        """Take no more connections."""
        with suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                caller, _ = self._listening.accept()
                threading.Thread(target=self._carry, args=(caller,), daemon=True).start()

    def _carry(self, caller: socket.socket) -> None:
        with caller, suppress(OSError):
            if isinstance(self._to, int):
                server = socket.create_connection(("127.0.0.1", self._to))
            else:
                server = socket.socket(socket.AF_UNIX)
                server.connect(self._to)
            with server:
                while True:
                    for source in select.select([caller, server], [], [])[0]:
                        piece = source.recv(65536)
                        if not piece:
                            return
                        (server if source is caller else caller).sendall(piece)


class Island:
    """A network namespace that a link joins with this machine's, until it is cut."""

    def __init__(self, name: str, link: str) -> None:
        self.name, self._link = name, link
        self.run = ("ip", "netns", "exec", name)

    def cut(self) -> None:
        """Drop everything, silently."""
        _ip("link", "set", self._link, "down")

    def join(self) -> None:
        """Let everything pass again."""
        _ip("link", "set", self._link, "up")

    def call(self, method: str, url: str, number: int | None = None) -> tuple[int, str]:
        """Status and body of a call from within."""
        code = (
            "import sys, httpx; from tests.sample_images import photo\n"
            "method, url, number = sys.argv[1:]\n"
            "sent = {'content': photo(int(number)), 'headers': {'content-type': 'image/jpeg'}} if number else {}\n"
            "answer = httpx.request(method, url, timeout=90, **sent); print(answer.status_code, answer.text)"
        )
        done = subprocess.run(
            [*self.run, sys.executable, "-c", code, method, url, "" if number is None else str(number)],
            cwd=ROOT, capture_output=True, text=True, check=True, timeout=120,
            env=os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'client'}"},
        )  # fmt: skip
        status, _, body = done.stdout.partition(" ")
        return int(status), body


def _ip(*arguments: str) -> None:
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise PermissionError(done.stderr.strip())


@contextmanager
def island() -> Iterator[tuple[Island, str]]:
    """A namespace, and the address of this machine as it is seen from there; skips where that is not permitted."""
    if shutil.which("ip") is None or os.geteuid() != 0:
        pytest.skip("NO PARTITION IS TRIED: needs root and the program ip")
    name = f"rv{uuid.uuid4().hex[:8]}"
    here, inside, subnet = f"{name}h", f"{name}n", f"10.{200 + os.getpid() % 50}.{os.getpid() // 50 % 250}"
    try:
        _ip("netns", "add", name)
        _ip("link", "add", here, "type", "veth", "peer", "name", inside, "netns", name)
        _ip("addr", "add", f"{subnet}.1/24", "dev", here)
        _ip("link", "set", here, "up")
        for command in (("addr", "add", f"{subnet}.2/24", "dev", inside), ("link", "set", inside, "up"),
                        ("link", "set", "lo", "up")):  # fmt: skip
            _ip("-n", name, *command)
    except PermissionError as error:
        with suppress(PermissionError):
            _ip("netns", "del", name)
        pytest.skip(f"NO PARTITION IS TRIED: this machine gives no network namespace ({error})")
    try:
        yield Island(name, here), f"{subnet}.1"
    finally:
        with suppress(PermissionError):
            _ip("netns", "del", name)


def test_a_partition_loses_nothing_and_the_node_behind_it_answers_nothing_stale(
    tmp_path: Path, there: dict[str, str], server: PostgresServer, objects: ObjectStore
) -> None:
    ledger = Ledger()
    with ExitStack() as stack:
        apart, address = stack.enter_context(island())
        folder = httpx.URL(server.url).params["host"]
        rows, images = Bridge(address, f"{folder}/.s.PGSQL.5432"), Bridge(address, int(objects.url.rpartition(":")[2]))
        stack.callback(rows.close)
        stack.callback(images.close)
        beyond = there | {
            "REVISIT_DATABASE": f"postgresql://postgres@{address}:{rows.port}/postgres",
            "AWS_ENDPOINT_URL_S3": f"http://{address}:{images.port}",
        }
        [(_, a)] = nodes(stack, tmp_path, there, "a")
        stack.enter_context(worker(tmp_path / "here", **there))
        until(a)

        class Beyond(RunningService):
            within = apart.run

        b = stack.enter_context(Beyond(tmp_path / "b", False, **beyond, REVISIT_INLINE_WORKER="false"))
        stack.enter_context(worker(tmp_path / "there", *apart.run, **beyond))
        for number in range(4):
            assert ledger.enroll(a, number)
        deadline = time.monotonic() + 60
        while apart.call("GET", f"{b.url}/readyz")[0] != 200:
            assert time.monotonic() < deadline
        status, body = apart.call("POST", f"{b.url}/query", 2)
        assert (status, ledger.kept[2] in body) == (200, True)

        later = [str(a.post("/enroll?wait=false", content=photo(n), headers=JPEG).json()["view"]["id"])
                 for n in range(100, 130)]  # fmt: skip
        apart.cut()
        began = time.monotonic()
        gone = ledger.delete(a, 2)
        assert gone is not None
        assert ledger.enroll(a, 10)
        while (left := a.get("/maps/default").json()["views"])["pending"]:  # also what the worker beyond had taken
            assert time.monotonic() - began < 60, left
            time.sleep(0.1)
        alone_s = time.monotonic() - began
        began = time.monotonic()
        status, body = apart.call("POST", f"{b.url}/query", 2)
        assert (status, gone in body) == (503, False), body
        assert apart.call("POST", f"{b.url}/enroll", 20)[0] == 503
        told_s = time.monotonic() - began
        assert a.get("/maps/default").json()["views"]["failed"] == 0

        apart.join()
        began = time.monotonic()
        while (answer := apart.call("POST", f"{b.url}/query", 2))[0] != 200:
            assert time.monotonic() - began < 60
        assert gone not in answer[1]
        status, body = apart.call("POST", f"{b.url}/query", 10)
        assert (status, ledger.kept[10] in body) == (200, True)
        back_s = time.monotonic() - began
        ledger.kept |= dict(zip(range(100, 130), later, strict=True))
        described(a, ledger)
        print(f"all described {alone_s:.1f} s after the cut, two refusals beyond it in {told_s:.1f} s, answers again "
              f"{back_s:.1f} s after it ended")  # fmt: skip
