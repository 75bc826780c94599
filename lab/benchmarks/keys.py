"""``./revisit benchmark keys``: what checking keys costs each request.

Two services in processes of their own, one with keys and one without, are called in turns, so that whatever else the
machine does meets both.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import httpx

from lab.faults.drawn import TYPE, image
from lab.faults.process import client, serve
from schemas.settings import Settings
from worker.service.keys import KeyService
from worker.storage.store import open_store

Call = Callable[[httpx.Client], httpx.Response]

CALLS: Mapping[str, Call] = {
    "GET /maps/default": lambda to: to.get("/maps/default"),
    "POST /query": lambda to: to.post("/query", content=image(1), headers=TYPE),
}


@dataclass(frozen=True)
class Cost:
    """What one kind of call takes, in ms: medians without and with keys, and the median of the differences of pairs."""

    call: str
    without: float
    checked: float
    difference: float


def measure(folder: Path, keys: int, repeats: int) -> list[Cost]:
    """Call both services `repeats` times each, in turns.

    Parameters
    ----------
    folder : Path
        Empty.
    keys : int
        How many the second service has; the last one made is used.
    repeats : int
    """
    given = _keys(folder / "keyed", keys)
    with ExitStack() as held:
        plain, keyed = (
            held.enter_context(client(held.enter_context(serve(folder / name)).url)) for name in ("plain", "keyed")
        )
        keyed.headers["authorization"] = f"Bearer {given}"
        for each in (plain, keyed):
            each.post("/enroll", content=image(1), headers=TYPE).raise_for_status()
        return [_cost(name, call, plain, keyed, repeats) for name, call in CALLS.items()]


def _keys(data: Path, count: int) -> str:
    """Make keys on a new data folder; returns the last one."""
    with closing(open_store(Settings(data=data).database_url, data)) as store:
        service = KeyService(store.keys)
        return [service.create(f"robot-{n}", "admin", datetime.now(UTC))[1] for n in range(count)][-1]


def _cost(name: str, call: Call, plain: httpx.Client, keyed: httpx.Client, repeats: int) -> Cost:
    times: dict[str, list[float]] = {"without": [], "checked": []}
    for turn in range(repeats + repeats // 10):  # the first tenth warms both
        pair = [("without", plain), ("checked", keyed)]
        for which, to in pair if turn % 2 else reversed(pair):
            began = time.perf_counter()
            call(to).raise_for_status()
            if turn >= repeats // 10:
                times[which].append(1000 * (time.perf_counter() - began))
    differences = [b - a for a, b in zip(times["without"], times["checked"], strict=True)]
    return Cost(name, *(statistics.median(some) for some in (times["without"], times["checked"], differences)))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="revisit benchmark keys", description=(__doc__ or "").partition("\n\n")[2])
    parser.add_argument("--keys", type=int, default=1000, help="keys of the service (default: 1000)")
    parser.add_argument("--repeats", type=int, default=1000, help="calls of each kind (default: 1000)")
    given = parser.parse_args(arguments)
    print(f"{given.keys} keys, {given.repeats} pairs of calls")
    print(f"{'medians, ms':20}{'without':>10}{'with':>10}{'of a pair':>12}")
    with tempfile.TemporaryDirectory(prefix="revisit-keys-") as folder:
        for cost in measure(Path(folder), given.keys, given.repeats):
            print(f"{cost.call:20}{cost.without:10.2f}{cost.checked:10.2f}{cost.difference:+12.3f}")
