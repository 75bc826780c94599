"""``./revisit benchmark memory``: the most memory that a service takes under loads of several kinds.

Each load meets a service of its own on an empty folder. The settings that memory depends on are taken from the
environment (those of `TRIED`), so that bounds can be tried before a container is given them. Callers go on without a
pause, in this process; what they were answered is counted, since a service that refuses takes little. Peaks are
resident memory (VmHWM): of the service, and of its decoders, which are processes of their own, together.
"""

import argparse
import os
import socket
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import cv2
import httpx
import numpy as np

from lab.benchmarks.sharing import JPEG
from lab.faults.images import peak_memory_mb
from lab.faults.process import Running, client, settings
from scenes.scene import scene

TRIED = {
    "REVISIT_ENCODER": "compact",
    "REVISIT_THREADS": "0",
    "REVISIT_BATCH": "0",
    "REVISIT_BODIES_MB": "256",
    "REVISIT_PIXELS_MB": "256",
    "REVISIT_MAX_BODY_MB": "25",
    "REVISIT_DECODERS": "2",
    "REVISIT_QUERIES": "32",
    "REVISIT_QUEUE": "1000",
    "REVISIT_CONNECTIONS": "512",
    "REVISIT_EXPLANATIONS": "200",
}
"""Settings that the environment may change, and what they are otherwise."""

PHOTOS = 6
"""Images that callers take turns with; bytes after its end make each one sent another file."""

STOPPED_BYTES, PROMISED_BYTES = 24_900_000, 25_000_000
"""What a caller that stops has sent of a body, and how much it said there would be."""

SLOW_BYTES, SLOW_S = 1000, 2.0
"""How much of an answer a slow reader reads, and how often."""

LOOKS_S = 0.1
"""Seconds between two looks at the decoders, which may be replaced meanwhile."""

Call = Callable[[httpx.Client, int, bytes], httpx.Response]


@dataclass(frozen=True)
class Load:
    """What meets the service: so many callers of a kind, with images of so many megapixels (0: no images)."""

    kind: str
    callers: int
    megapixels: float


LOADS = (
    Load("idle", 0, 0),
    Load("turns", 40, 0.3),
    Load("turns", 40, 2),
    Load("turns", 100, 2),
    Load("turns", 8, 12),
    Load("turns", 100, 12),
    Load("queries", 30, 12),
    Load("queries", 100, 12),
    Load("enrolments", 100, 12),
    Load("drawings", 30, 12),
    Load("comparisons", 30, 12),
    Load("stopped", 60, 0),
    Load("slow", 60, 6.7),
)


def photos(megapixels: float) -> list[bytes]:
    """JPEGs of drawn streets of so many megapixels, 4:3."""
    width = round((megapixels * 1e6 * 4 / 3) ** 0.5)
    size = (width, round(width * 3 / 4))
    drawn = (
        cv2.resize(scene(f"street {number}").pixels, size, interpolation=cv2.INTER_CUBIC) for number in range(PHOTOS)
    )
    return [bytes(cv2.imencode(".jpg", pixels[:, :, ::-1])[1]) for pixels in drawn]


def noise(megapixels: float) -> bytes:
    """A PNG of so many megapixels that cannot be compressed: 3 bytes a pixel."""
    side = round((megapixels * 1e6) ** 0.5)
    return bytes(cv2.imencode(".png", np.random.default_rng(0).integers(0, 256, (side, side, 3), np.uint8))[1])


def send(calls: httpx.Client, to: str, sent: bytes, explain: bool = False) -> httpx.Response:
    """One query, or one enrolment that is waited for."""
    return calls.post(to, params={"explain": "true"} if explain else {}, content=sent, headers=JPEG)


def draw(calls: httpx.Client, _: int, sent: bytes) -> httpx.Response:
    """A query with its explanation, then the drawing of its best match."""
    answer = send(calls, "/query", sent, explain=True)
    matches = answer.json()["matches"] if answer.status_code == 200 else []
    return calls.get(matches[0]["links"]["explanation"]) if matches else answer


def compare(calls: httpx.Client, _: int, sent: bytes) -> httpx.Response:
    """A query with its explanation, then what changed since its best match."""
    answer = send(calls, "/query", sent, explain=True)
    return calls.get(f"/queries/{answer.json()['query']['id']}/changes.png") if answer.status_code == 200 else answer


WITHOUT_PAUSE: Mapping[str, Call] = {
    "turns": lambda calls, number, sent: send(calls, "/enroll" if number % 2 else "/query", sent),
    "queries": lambda calls, _, sent: send(calls, "/query", sent),
    "enrolments": lambda calls, _, sent: send(calls, "/enroll", sent),
    "drawings": draw,
    "comparisons": compare,
}
"""What callers do again and again, by kind; the number is that of the call."""


def go_on(call: Call, url: str, caller: int, images: Sequence[bytes], until: float, answers: Counter[str]) -> None:
    """Call after call until a moment."""
    number = 0
    with client(url) as calls:
        while time.monotonic() < until:
            number += 1
            sent = images[(caller + number) % PHOTOS] + caller.to_bytes(2, "big") + number.to_bytes(4, "big")
            try:
                answers[str(call(calls, number, sent).status_code)] += 1
            except httpx.TransportError as error:
                answers[type(error).__name__] += 1


@contextmanager
def connection(url: str) -> Iterator[socket.socket]:
    """A connection to the service that takes little at once."""
    place = httpx.URL(url)
    with socket.create_connection((place.host, place.port)) as opened:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        yield opened


def stop_amid(url: str, until: float, answers: Counter[str]) -> None:
    """Send most of a body, and wait for what comes."""
    with connection(url) as opened:
        opened.settimeout(max(0.1, until - time.monotonic()))
        head = "POST /query HTTP/1.1\r\nHost: revisit\r\nContent-Type: image/jpeg\r\nContent-Length: "
        try:
            opened.sendall(f"{head}{PROMISED_BYTES}\r\n\r\n".encode())
            opened.sendall(bytes(STOPPED_BYTES))
            answers[opened.recv(64)[9:12].decode() or "closed"] += 1
        except TimeoutError:
            answers["none yet"] += 1
        except OSError as error:
            answers[type(error).__name__] += 1


def read_slowly(url: str, view: str, until: float, answers: Counter[str]) -> None:
    """Ask for an image, and read little of it now and then."""
    with connection(url) as opened:
        opened.sendall(f"GET /views/{view}/image HTTP/1.1\r\nHost: revisit\r\n\r\n".encode())
        try:
            while time.monotonic() < until and opened.recv(SLOW_BYTES):
                time.sleep(SLOW_S)
            answers["read on" if time.monotonic() >= until else "closed"] += 1
        except OSError as error:
            answers[type(error).__name__] += 1


def callers(load: Load, url: str, seconds: float, answers: Counter[str]) -> list[Callable[[], None]]:
    """What each caller does, for so many seconds from now on, once what it sends is drawn and a view is enrolled."""
    if load.kind == "idle":
        return [partial(time.sleep, seconds)]
    if load.kind == "stopped":
        return [partial(stop_amid, url, time.monotonic() + seconds, answers)] * load.callers
    with client(url) as calls:
        if load.kind == "slow":
            sent = {"content-type": "image/png"}
            view = calls.post("/enroll", content=noise(load.megapixels), headers=sent).raise_for_status().json()["view"]
            return [partial(read_slowly, url, view["id"], time.monotonic() + seconds, answers)] * load.callers
        images = photos(load.megapixels)
        send(calls, "/enroll", images[0]).raise_for_status()
    call, until = WITHOUT_PAUSE[load.kind], time.monotonic() + seconds
    return [partial(go_on, call, url, caller, images, until, answers) for caller in range(load.callers)]


def children(pid: int) -> Iterator[int]:
    """Process ids of what the threads of a process have started (``/proc``, proc(5))."""
    for thread in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):  # it has ended
            yield from map(int, thread.read_text().split())


def measured(load: Load, seconds: float, further: Mapping[str, str]) -> tuple[float, float, Counter[str]]:
    """Peaks of a service and of its decoders in 10^6 bytes, and how often callers were answered what.

    Raises
    ------
    NotStarted
    AssertionError
        When the service has ended.
    """
    answers: Counter[str] = Counter()
    with (
        tempfile.TemporaryDirectory(prefix="revisit-memory-") as folder,
        Running("serve", settings(Path(folder), further), warm=False) as service,
    ):
        service.await_ready()
        works = callers(load, service.url, seconds, answers)
        decoders: dict[int, float] = {}
        with ThreadPoolExecutor(len(works)) as threads:
            under_way = {threads.submit(work) for work in works}
            while under_way:
                done, under_way = wait(under_way, LOOKS_S)
                decoders |= {child: peak_memory_mb(child) for child in children(service.pid)}
                for each in done:
                    each.result()
        assert service.alive, service.output[-4000:]
        return peak_memory_mb(service.pid), sum(decoders.values()), answers


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for each load."""
    parser = argparse.ArgumentParser(prog="revisit benchmark memory", description=(__doc__ or "").partition("\n\n")[2])
    kinds = dict.fromkeys(load.kind for load in LOADS)
    parser.add_argument("--kinds", nargs="+", choices=kinds, default=list(kinds), help="of callers (default: all)")
    parser.add_argument("--callers", type=int, help="as many in each load that has callers (default: by load)")
    parser.add_argument("--megapixels", type=float, help="of each photo that is sent (default: by load)")
    parser.add_argument("--seconds", type=float, default=15.0, help="of each load (default: 15)")
    given = parser.parse_args(arguments)
    further = {name: os.environ.get(name, usual) for name, usual in TRIED.items()}
    changed = "".join(f", {name}={value}" for name, value in further.items() if value != TRIED[name])
    print(f"{datetime.now(UTC):%Y-%m-%d}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}{changed}")
    print(f"{'callers':>8}  {'kind':12}{'megapixels':>10}{'service':>12}{'decoders':>12}  answers")
    loads = dict.fromkeys(
        Load(
            load.kind,
            given.callers if load.callers and given.callers else load.callers,
            given.megapixels if load.megapixels and given.megapixels else load.megapixels,
        )
        for load in LOADS
        if load.kind in given.kinds
    )
    for load in loads:
        service, decoders, answers = measured(load, given.seconds, further)
        told = ", ".join(f"{count} x {answer}" for answer, count in sorted(answers.items()))
        print(
            f"{load.callers:8}  {load.kind:12}{load.megapixels:10g}{service:9.0f} MB{decoders:9.0f} MB  {told}",
            flush=True,
        )
