"""A data folder and the service on it, through restarts and kills; every answer is judged by its status."""

import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

from lab.faults.injected import set_clock
from lab.faults.ledger import Violation, require
from lab.faults.process import TOLD, Running, client, serve
from lab.faults.run import Tally, data_folder

SETTLE_S = 60.0
"""Seconds within which a few images must be described."""


QUICK = {"REVISIT_DECODERS": "1", "REVISIT_LEASE_S": "1"}
"""What a killed process was describing is described again after a second: every check after a kill waits for it. A
further decoder would take as long to start as the service itself."""


class LiveService:
    """A service that can be restarted on the same data.

    Parameters
    ----------
    data : Path
    counts : Counter
        Gets the starts, and how long they took in ms.
    told : bool
        Whether the process obeys `lab.faults.injected`.
    settings : mapping of str to str, optional
        Further ``REVISIT_*`` variables.
    """

    def __init__(
        self, data: Path, counts: Counter[str], *, told: bool = False, settings: Mapping[str, str] | None = None
    ) -> None:
        self.data, self._counts = data, counts
        self._settings = {**(settings or {}), **({TOLD: "yes"} if told else {})}
        self.clock_s = 0.0
        self.start()

    def start(self) -> None:
        """Start it; the clock of the process is as wrong as before."""
        self.running: Running = serve(self.data, self._settings)
        self._counts["starts"] += 1
        self.client = client(self.running.url)
        if self.clock_s:
            self.set_clock(self.clock_s)

    def set_clock(self, offset_s: float) -> None:
        """Let its clock be wrong from now on."""
        set_clock(self.running.orders, offset_s)
        self.clock_s = offset_s

    def stop(self) -> None:
        """SIGTERM; raises Violation when it does not end well."""
        self.client.close()
        code = self.running.stop()
        require(code == 0, f"the service ended with {code} after SIGTERM:\n{self.running.output[-3000:]}")
        self.running.close()

    def kill(self) -> None:
        """SIGKILL."""
        self.running.kill()
        self.client.close()
        self.running.close()

    def close(self) -> None:
        """Kill it, whatever its state."""
        self.client.close()
        self.running.close()

    def call(self, method: str, path: str, *expected: int, **sent: Any) -> httpx.Response:
        """Call it; raises Violation when the status is not among the `expected` (200, if none is given)."""
        answer = self.client.request(method, path, **sent)
        if answer.status_code not in (expected or (200,)):
            log = self.running.output[-3000:] if answer.status_code >= 500 else ""
            raise Violation(f"{method} {path} answered {answer.status_code}: {answer.text[:600]}\n{log}")
        require(answer.headers.get("x-request-id"), f"{method} {path}: no X-Request-Id")
        return answer

    def json(self, path: str, **parameters: str) -> Any:
        """The JSON of a GET."""
        return self.call("GET", path, params=parameters).json()

    def await_job(self, job: str) -> str:
        """Wait until a job has ended; returns its state, ``gone`` when it went with its view or map."""
        until = time.monotonic() + SETTLE_S
        while True:
            answer = self.call("GET", f"/jobs/{job}", 200, 404)
            if answer.status_code == 404:
                return "gone"
            state = str(answer.json()["state"])
            if state not in ("waiting", "running"):
                return state
            require(time.monotonic() < until, f"job {job} is still {state} after {SETTLE_S:.0f} s")
            time.sleep(0.003)

    def settle(self) -> None:
        """Wait until no view is pending."""
        until = time.monotonic() + SETTLE_S
        while pending := sum(facts["views"]["pending"] for facts in self.json("/maps")["maps"]):
            require(time.monotonic() < until, f"{pending} views are still pending after {SETTLE_S:.0f} s")
            time.sleep(0.005)


@contextmanager
def timed_service(
    tally: Tally, folder: Path | None, settings: Mapping[str, str] | None = None
) -> Iterator[LiveService]:
    """A service on a data folder of its own during a block, whose seconds go to the tally.

    Parameters
    ----------
    tally : Tally
        Gets the starts too.
    folder : Path or None
        Where the data folder is made; None: in memory.
    settings : mapping of str to str, optional
        Further ``REVISIT_*`` variables.
    """
    began = time.monotonic()
    with data_folder(folder) as data:
        service = LiveService(data, tally.counts, settings=settings)
        try:
            yield service
        finally:
            service.close()
    tally.seconds = time.monotonic() - began
