"""``python -m lab.faults.soak``: memory, open files, threads, temporary files and the write-ahead log stay flat.

Judged by the slope over the samples after a warm-up, under a load of sound calls, refused ones, and callers who break
off. The number of views stays the same meanwhile, so nothing has a reason to grow.
"""

import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import numpy as np
import psutil

from lab.faults.drawn import TYPE, image
from lab.faults.enrolling import LABELS, LIGHT
from lab.faults.ledger import Violation, require
from lab.faults.live_service import LiveService, timed_service
from lab.faults.process import client
from lab.faults.run import Progress, Tally, parser, seed_of

LOADS = 3
VIEWS = 30
"""Views that each load keeps."""

EVERY_S = 0.5
"""Seconds between two samples."""

WARM_UP = 0.4
"""Share of the run after which growth counts: threads, caches and the allocator have what they need by then."""

SETTINGS = {"REVISIT_EXPLANATIONS": "20", "REVISIT_MAX_BODY_MB": "1"}
"""Explanations are kept up to a number; a small one is reached at once."""


@dataclass(frozen=True)
class Bound:
    """How much a measure may grow between the warm-up and the end of a run.

    Parameters
    ----------
    growth : float
        At most this much by the fitted slope, in the measure's unit,
    share : float
        and this share of its median beyond that: of memory, the noise is a share.
    """

    growth: float
    share: float = 0.0


BOUNDS: Mapping[str, Bound] = {
    "memory, MB": Bound(8, 0.04),
    "open files": Bound(4),
    "threads": Bound(3),
    "temporary files": Bound(2),
    "write-ahead log, MB": Bound(6),
}


def sample(process: psutil.Process, data: Path) -> dict[str, float]:
    """The measures of a process at this moment."""
    log = data / "revisit.db-wal"
    temporary = sum(1 for path in (data / "pictures").rglob(".writing-*"))
    return {
        "memory, MB": process.memory_info().rss / 1e6,
        "open files": process.num_fds(),
        "threads": process.num_threads(),
        "temporary files": temporary + sum(1 for file in process.open_files() if file.path.startswith("/tmp/")),
        "write-ahead log, MB": log.stat().st_size / 1e6 if log.exists() else 0.0,
    }


def growth(seconds: Sequence[float], values: Sequence[float]) -> float:
    """What the fitted line through samples grows by from the first to the last, in the unit of the values."""
    if len(values) < 3:
        return 0.0
    slope = np.polyfit(np.asarray(seconds), np.asarray(values), 1)[0]
    return float(slope * (seconds[-1] - seconds[0]))


def judge(seconds: Sequence[float], samples: Sequence[Mapping[str, float]]) -> tuple[list[str], list[str]]:
    """A line for each measure, and those that grew more than their bound; of samples after the warm-up."""
    lines, grown = [], []
    for name, bound in BOUNDS.items():
        values = [one[name] for one in samples]
        middle, more = float(np.median(values)), growth(seconds, values)
        allowed = bound.growth + bound.share * middle
        lines.append(
            f"{name}: median {middle:.1f}, most {max(values):.1f}, grew by {more:+.2f} (at most {allowed:.1f})"
        )
        if more > allowed:
            grown.append(f"grows: {lines[-1]}")
    return lines, grown


class Load:
    """One caller of everything, sound and unsound, in a thread of its own.

    Parameters
    ----------
    number : int
    seed : int
    """

    def __init__(self, number: int, seed: int) -> None:
        self.map, self.chance = f"soak-{number}", np.random.default_rng([seed, number])
        self.counts: Counter[str] = Counter()
        self.violation: str | None = None
        self.is_full = threading.Event()
        self._views: list[str] = []
        self._images = number * 10_000_000

    def work(self, url: str, until: threading.Event) -> None:
        """Enrol and delete until there are enough views, then call until `until` is set or an answer is wrong."""
        kinds = [self._turn_over, self._query, self._refused, self._draw, self._break_off, self._read]
        try:
            with client(url) as calls:
                while len(self._views) < VIEWS and not until.is_set():
                    self._turn_over(calls)
                self._turn_over(calls)
                self.is_full.set()
                while not until.is_set():
                    kind = kinds[int(self.chance.choice(len(kinds), p=[0.3, 0.25, 0.15, 0.05, 0.15, 0.1]))]
                    kind(calls)
                    self.counts[kind.__name__.strip("_").replace("_", " ")] += 1
        except (Violation, httpx.HTTPError) as error:
            self.violation = f"{self.map}: {error!r}"
            until.set()

    def _sent(self, answer: httpx.Response, *expected: int) -> httpx.Response:
        require(answer.status_code in expected, f"{answer.request.method} {answer.request.url}: "
                f"{answer.status_code} {answer.text[:300]}")  # fmt: skip
        return answer

    def _turn_over(self, calls: httpx.Client) -> None:
        """Enrol one; delete the oldest once there are enough."""
        self._images += 1
        form = {"map": self.map, "place": "gate", "metadata": '{"a": 1}'}
        answer = self._sent(calls.post("/enroll", data=form, files={"image": image(self._images)}), 201)
        self._views.append(answer.json()["view"]["id"])
        if len(self._views) > VIEWS:
            self._sent(calls.delete(f"/views/{self._views.pop(0)}"), 200)

    def _query(self, calls: httpx.Client) -> None:
        number = self._images - int(self.chance.integers(VIEWS))
        explain = {"explain": "true"} if self.chance.random() < 0.2 else {}
        given = {"map": self.map, **explain}
        self._sent(calls.post("/query", params=given, content=image(number), headers=TYPE), 200)

    def _refused(self, calls: httpx.Client) -> None:
        """Broken images, wrong parameters, wrong paths, too many bytes."""
        data, given = image(self._images), {"map": self.map}
        kind = int(self.chance.integers(6))
        if kind == 0:
            self._sent(calls.post("/enroll", params=given, content=data[:-40], headers=TYPE), 422)
        elif kind == 1:
            self._sent(calls.post("/query", params=given, content=b"%PDF-1.7", headers=TYPE), 415)
        elif kind == 2:
            self._sent(calls.post("/enroll", params={**given, "x": "1", "nonsense": "1"}, content=data), 422)
        elif kind == 3:
            self._sent(calls.get("/views/01890000-0000-7000-8000-000000000000"), 404)
        elif kind == 4:
            self._sent(calls.post("/enroll", params=given, content=b"--a\r\nbroken off",
                                  headers={"content-type": "multipart/form-data; boundary=a"}), 400)  # fmt: skip
        else:
            self._sent(calls.patch(f"/maps/{self.map}", content=b'{"ranking": '), 400)

    def _draw(self, calls: httpx.Client) -> None:
        if self._views:
            path = str(self.chance.choice(["thumbnail", "segmentation.png", "graph.png", "image"]))
            self._sent(calls.get(f"/views/{self._views[-1]}/{path}"), 200)

    def _read(self, calls: httpx.Client) -> None:
        path = str(self.chance.choice(["/maps", "/views?limit=20", "/jobs", "/metrics", "/readyz", "/", "/docs"]))
        self._sent(calls.get(path), 200)

    def _break_off(self, calls: httpx.Client) -> None:
        """Announce more bytes than are sent, or do not wait for the answer; then hang up."""
        at = urlsplit(str(calls.base_url))
        data = image(self._images)
        whole = bool(self.chance.random() < 0.5)
        announced = len(data) if whole else len(data) + 1000
        head = (
            f"POST /query?map={self.map} HTTP/1.1\r\nHost: x\r\nContent-Type: image/png\r\nContent-Length: {announced}"
        )
        with socket.create_connection((at.hostname, at.port), timeout=30) as connection:
            connection.sendall(head.encode() + data)


def soak(served: LiveService, minutes: float, seed: int, counts: Counter[str]) -> tuple[list[str], list[str]]:
    """Load a service for so long; returns a line for each measure, and what was wrong."""
    loads = [Load(number, seed) for number in range(1, LOADS + 1)]
    for load in loads:
        served.call("PUT", f"/maps/{load.map}", 201, json={**LIGHT, "labels": LABELS[0], "dynamic": []})
    until = threading.Event()
    threads = [threading.Thread(target=load.work, args=(served.running.url, until)) for load in loads]
    for thread in threads:
        thread.start()
    for load in loads:  # until then the number of views grows, and threads that delete are still made
        while not (load.is_full.wait(EVERY_S) or until.is_set()):
            pass
    process, progress = psutil.Process(served.running.pid), Progress("soak", every_s=60)
    began = time.monotonic()
    seconds: list[float] = []
    samples: list[dict[str, float]] = []
    while (now := time.monotonic() - began) < 60 * minutes and not until.wait(EVERY_S):
        if now > WARM_UP * 60 * minutes:
            seconds.append(now)
            samples.append(sample(process, served.data))
        progress.tell(round(now), round(60 * minutes), counts)
    until.set()
    for thread in threads:
        thread.join()
    for load in loads:
        counts.update(load.counts)
    wrong = [load.violation for load in loads if load.violation]
    if not samples:
        return [], [*wrong, "it ended before anything was measured"]
    lines, grown = judge(seconds, samples)
    return lines, wrong + grown


def main(argv: Sequence[str] | None = None) -> int:
    """Run; returns 1 when something grows."""
    options = parser("Memory, open files, threads, temporary files and the write-ahead log stay flat.")
    options.add_argument("--minutes", type=float, default=30, help="(default: 30)")
    arguments = options.parse_args(argv)
    tally = Tally("soak", seed_of(arguments))
    with timed_service(tally, arguments.folder, SETTINGS) as served:
        lines, wrong = soak(served, arguments.minutes, tally.seed, tally.counts)
    tally.violations += wrong
    print("\n".join(lines))
    return tally.finish()


if __name__ == "__main__":
    sys.exit(main())
