"""``python -m lab.faults.clients``: many clients at once, each of which must get its own answers.

Every client has images, a map and request ids of its own. A view is found by the first query after it was
acknowledged, is never found after its deletion, and no answer holds anything of another client.
"""

import sys
import threading
import time
from collections import Counter
from collections.abc import Sequence
from typing import Any

import httpx
import numpy as np

from lab.faults.callers import APART
from lab.faults.drawn import TYPE, digest, image
from lab.faults.enrolling import LABELS, LIGHT
from lab.faults.ledger import Violation, require
from lab.faults.live_service import LiveService, timed_service
from lab.faults.process import client
from lab.faults.run import Tally, parser, seed_of

SHARED = "shared"
MOST = 8
"""Views that a client keeps in each map."""

PATIENCE_S = 300
"""Seconds in which a view must be described that nobody waited for any longer."""

BUSY = (429, 503)
"""Statuses of a service that is asked for too much; the client waits and tries again."""


class Client:
    """One of many clients.

    Parameters
    ----------
    number : int
        From 1.
    seed : int
    """

    def __init__(self, number: int, seed: int) -> None:
        self.number, self.own = number, f"own-{number}"
        self.chance = np.random.default_rng([seed, number])
        self.counts: Counter[str] = Counter()
        self.violation: str | None = None
        self._views: dict[str, list[tuple[str, int]]] = {SHARED: [], self.own: []}
        self._calls = self._images = 0

    def work(self, url: str, until: threading.Event) -> None:
        """Enrol, query and delete until `until` is set or something is wrong."""
        try:
            with client(url) as calls:
                while not until.is_set():
                    self._turn(calls, until)
        except (Violation, httpx.HTTPError) as error:
            self.violation = f"client {self.number}: {error!r}"
            until.set()

    def _turn(self, calls: httpx.Client, until: threading.Event) -> None:
        name = SHARED if self.chance.random() < 0.5 else self.own
        views = self._views[name]
        if len(views) < MOST and (not views or self.chance.random() < 0.4):
            self._images += 1
            number = self.number * APART + self._images
            answer = self._call(calls, until, "POST", "/enroll", (201, 202), name, number)
            require(answer["view"]["image"]["sha256"] == digest(image(number)), "enrolled another client's image")
            require(answer["view"]["map"] == name, f"enrolled in {answer['view']['map']}, not in {name}")
            views.append((answer["view"]["id"], number))
            if answer["view"]["state"] == "pending":  # 202: not described within `REVISIT_WAIT`
                self._await_description(calls, until, answer["job"])
            self._find(calls, until, name, *views[-1])
            self.counts["enrolments found by the next query"] += 1
        elif self.chance.random() < 0.7:
            self._find(calls, until, name, *views[int(self.chance.integers(len(views)))])
            self.counts["queries"] += 1
        else:
            view_id, number = views.pop(int(self.chance.integers(len(views))))
            require(self._call(calls, until, "DELETE", f"/views/{view_id}", (200,))["views"] == 1, "deleted nothing")
            answer = self._call(calls, until, "POST", "/query", (200,), name, number)
            found = [match["view"]["id"] for match in answer["matches"]]
            require(view_id not in found, f"view {view_id} was found after its deletion")
            self.counts["deletions not found by the next query"] += 1

    def _await_description(self, calls: httpx.Client, until: threading.Event, job: str) -> None:
        self.counts["enrolments described later than callers wait"] += 1
        since = time.monotonic()
        while (told := self._call(calls, until, "GET", f"/jobs/{job}", (200,)))["state"] in ("waiting", "running"):
            require(time.monotonic() - since < PATIENCE_S, f"job {job} is {told['state']} after {PATIENCE_S} s")
            time.sleep(0.2)
        require(told["state"] == "done", f"job {job} is {told['state']}")

    def _find(self, calls: httpx.Client, until: threading.Event, name: str, view_id: str, number: int) -> None:
        answer = self._call(calls, until, "POST", "/query", (200,), name, number)
        require(answer["map"] == name, f"a query of {name} was answered from {answer['map']}")
        first = answer["matches"][0]["view"] if answer["matches"] else None
        require(first is not None and first["id"] == view_id, f"image {number} found {first}, not {view_id}")

    def _call(
        self,
        calls: httpx.Client,
        until: threading.Event,
        method: str,
        path: str,
        expected: tuple[int, ...],
        name: str | None = None,
        number: int | None = None,
    ) -> Any:
        """Call until the service has time; the answer's request id must be the call's."""
        while True:
            self._calls += 1
            request_id = f"client-{self.number}-{self._calls}"
            content = None if number is None else image(number)
            answer = calls.request(
                method,
                path,
                params={} if name is None else {"map": name},
                content=content,
                headers={"x-request-id": request_id, **(TYPE if content else {})},
            )
            told = answer.headers.get("x-request-id")
            require(told == request_id, f"{method} {path}: request id {told}, not {request_id}")
            if answer.status_code not in BUSY:
                break
            require("retry-after" in answer.headers, f"{answer.status_code} without Retry-After")
            self.counts["told to wait"] += 1
            until.wait(0.2)
        require(answer.status_code in expected, f"{method} {path}: {answer.status_code} {answer.text[:500]}")
        return answer.json()


def churn(served: LiveService, clients: int, seconds: float, seed: int, counts: Counter[str]) -> list[str]:
    """Let so many clients work for so long; returns what was wrong."""
    everybody = [Client(number, seed) for number in range(1, clients + 1)]
    for name in (SHARED, *(one.own for one in everybody)):
        served.call("PUT", f"/maps/{name}", 201, json={**LIGHT, "labels": LABELS[0], "dynamic": []})
    until = threading.Event()
    threads = [threading.Thread(target=one.work, args=(served.running.url, until)) for one in everybody]
    for thread in threads:
        thread.start()
    until.wait(seconds)
    until.set()
    for thread in threads:
        thread.join()
    for one in everybody:
        counts.update(one.counts)
    counts["clients"] += clients
    idle = [one.number for one in everybody if not one.counts]
    return [one.violation for one in everybody if one.violation] + [f"client {number} got no answer" for number in idle]


def main(argv: Sequence[str] | None = None) -> int:
    """Run; returns 1 after any violation."""
    options = parser("Many clients at once, each of which must get its own answers.")
    options.add_argument("--clients", type=int, default=16, help="(default: 16)")
    options.add_argument("--minutes", type=float, default=10, help="(default: 10)")
    arguments = options.parse_args(argv)
    tally = Tally("clients", seed_of(arguments))
    with timed_service(tally, arguments.folder) as served:
        tally.violations += churn(served, arguments.clients, 60 * arguments.minutes, tally.seed, tally.counts)
    return tally.finish()


if __name__ == "__main__":
    sys.exit(main())
