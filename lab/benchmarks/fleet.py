"""``./revisit benchmark fleet``: what PostgreSQL costs a query against SQLite, and what a second worker gives.

Needs an empty PostgreSQL database. First images wait in it, and one worker describes them, or two, in turns; each has a
core to itself as far as the machine has as many, which PostgreSQL and whatever else runs share with it. Then a map of
the same descriptions is put into both databases, and two services, which search it in memory, are queried in turns.
"""

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path

import httpx
import psutil
import sqlalchemy as sa

from lab.benchmarks.filling import fill
from lab.benchmarks.sharing import JPEG, decode, drawn
from lab.faults.drawn import TYPE, image
from lab.faults.process import Running, client, settings
from schemas.description import Description
from schemas.settings import read_settings
from worker.description.presets import Wanted
from worker.runtime import build
from worker.storage.store import open_store

SQLITE, POSTGRESQL = "sqlite", "postgresql"

FROM, TO = 0.85, 0.1
"""Shares of the images that wait between which the rate is taken: all workers have started, none is idle."""

LOOKS_S = 0.1
"""Seconds between two looks at how many still wait: each costs the node some of the workers' cores."""


@contextmanager
def serving(data: Path, further: dict[str, str]) -> Iterator[httpx.Client]:
    """A service as a process, and calls of it."""
    with Running("serve", settings(data, {"REVISIT_COMPARE": "false", **further})) as process:
        process.await_ready()
        with client(process.url) as calls:
            yield calls


@contextmanager
def working(data: Path, further: dict[str, str], core: int) -> Iterator[psutil.Process]:
    """A worker as a process on one core, with those of its decoders."""
    mine = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {sorted(mine)[core % len(mine)]})
    try:
        process = Running("worker", settings(data, {"REVISIT_COMPARE": "false", **further}), warm=False)
    finally:
        os.sched_setaffinity(0, mine)
    with process:
        yield psutil.Process(process.pid)


def used_s(processes: Sequence[psutil.Process]) -> float:
    """Seconds of CPU that some processes and their children have had."""
    times = [each.cpu_times() for one in processes for each in (one, *one.children(recursive=True))]
    return float(sum(each.user + each.system for each in times))


def described(calls: httpx.Client, data: Path, there: dict[str, str], workers: int, images: int) -> tuple[float, float]:
    """How many images so many workers describe in a second, and on how many cores; as many wait when they start."""
    into = f"round-{time.time_ns()}"
    for number in range(images):
        sent = {"map": into, "wait": "false"}
        calls.post("/enroll", params=sent, content=image(number), headers=TYPE).raise_for_status()
    at: dict[float, tuple[float, float]] = {}
    with ExitStack() as held:
        processes = [held.enter_context(working(data, there, core)) for core in range(workers)]
        while TO not in at:
            waiting = calls.get(f"/maps/{into}").raise_for_status().json()["views"]["pending"]
            for share in (FROM, TO):
                if waiting <= share * images:
                    at.setdefault(share, (time.perf_counter(), used_s(processes)))
            time.sleep(LOOKS_S)
        while calls.get(f"/maps/{into}").raise_for_status().json()["views"]["pending"]:
            time.sleep(LOOKS_S)
    calls.delete(f"/maps/{into}").raise_for_status()
    took, used = (end - begin for begin, end in zip(at[FROM], at[TO], strict=True))
    return (FROM - TO) * images / took, used / took


def filled(folder: Path, urls: dict[str, str | None], encoder: str, views: int, streets: Sequence[bytes]) -> None:
    """Put a map of so many views, the same ones, into each database."""
    descriptions: list[Description] = []
    for name, url in urls.items():
        chosen = read_settings({}, data=folder / name, database=url, encoder=encoder, inline_worker=False, threads=1)
        runtime = build(chosen)
        recipe = runtime.default_recipe.description
        describer = runtime.describers.of(recipe)
        if not descriptions:
            for one in map(decode, streets):
                field = next(iter(runtime.encoder.encode([one])))
                descriptions.append(describer.describe(one, field, describer.keypoints(one)))
        runtime.services.maps.put("default", Wanted())
        runtime.store.close()
        runtime.unlock()
        began = time.perf_counter()
        fill(chosen.database_url, "default", recipe, descriptions, views, seed=1)
        engine = sa.create_engine(chosen.database_url)
        with engine.begin() as connection:
            connection.execute(sa.text("ANALYZE"))
        engine.dispose()
        print(f"{name}: {views:,} views in {time.perf_counter() - began:.0f} s", flush=True)


def queries(
    clients: dict[str, httpx.Client], streets: Sequence[bytes], repeats: int
) -> dict[str, list[tuple[float, float]]]:
    """Milliseconds of each query, in turns: as its caller sees it, and without the stages of the network."""
    took: dict[str, list[tuple[float, float]]] = {name: [] for name in clients}
    for turn in range(repeats + 3):  # the first three load the index and warm both
        for name in sorted(clients, reverse=bool(turn % 2)):
            began = time.perf_counter()
            answer = clients[name].post("/query", content=streets[turn % len(streets)], headers=JPEG).raise_for_status()
            whole = 1000 * (time.perf_counter() - began)
            if turn >= 3:
                took[name].append((whole, whole - answer.json()["timing_ms"]["encode"]))
    return took


def checks(folder: Path, urls: dict[str, str | None], repeats: int = 500) -> dict[str, list[tuple[float, float]]]:
    """Milliseconds of asking for the revision of a map, as each query does first, in turns: passed, and of CPU here."""
    took: dict[str, list[tuple[float, float]]] = {name: [] for name in urls}
    with ExitStack() as held:
        stores = {}
        for name, url in urls.items():
            given = read_settings({}, data=folder / name, database=url)
            stores[name] = held.enter_context(closing(open_store(given.database_url, given.data)))
        for _ in range(repeats):
            for name, store in stores.items():
                began, used = time.perf_counter(), time.thread_time()
                store.maps.get("default")
                took[name].append((1000 * (time.perf_counter() - began), 1000 * (time.thread_time() - used)))
    return took


def main(arguments: Sequence[str] | None = None) -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(prog="revisit benchmark fleet", description=(__doc__ or "").partition("\n\n")[2])
    parser.add_argument("--database", required=True, help="URL of an empty PostgreSQL database")
    parser.add_argument("--views", type=int, default=100_000, help="of the map (default: 100000)")
    parser.add_argument("--encoder", default="compact", choices=("compact", "color"), help="of the queries")
    parser.add_argument("--repeats", type=int, default=40, help="queries to each service (default: 40)")
    parser.add_argument("--images", type=int, default=200, help="images of each round of describing (default: 200)")
    parser.add_argument("--rounds", type=int, default=3, help="rounds of describing, by color (default: 3)")
    given = parser.parse_args(arguments)
    there = {"REVISIT_DATABASE": given.database, "REVISIT_INLINE_WORKER": "false"}
    with tempfile.TemporaryDirectory(prefix="revisit-fleet-") as name:
        folder = Path(name)
        print(f"{datetime.now(UTC):%Y-%m-%d}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}", flush=True)
        if given.rounds:
            rates: dict[int, list[tuple[float, float]]] = {1: [], 2: []}
            with serving(folder / "workers", there) as calls:
                for _ in range(given.rounds):
                    for count, found in rates.items():
                        found.append(described(calls, folder / "workers", there, count, given.images))
            one, two = (statistics.median(rate for rate, _ in each) for each in rates.values())
            print(f"images a second, medians: one worker {one:.1f}, two {two:.1f}, ratio {two / one:.2f}", flush=True)
            on_one, on_two = (statistics.median(cores for _, cores in each) for each in rates.values())
            one, two = (statistics.median(rate / cores for rate, cores in each) for each in rates.values())
            print(f"cores that they got: {on_one:.2f}, {on_two:.2f}; images for each second of a core: {one:.1f}, "
                  f"{two:.1f}, ratio {two / one:.2f}", flush=True)  # fmt: skip
        streets = [drawn(number) for number in range(24)]
        urls: dict[str, str | None] = {SQLITE: None, POSTGRESQL: given.database}
        filled(folder, urls, given.encoder, given.views, streets)
        for kind, each in checks(folder, urls).items():
            passed, used = (statistics.quantiles(column, n=10) for column in zip(*each, strict=True))
            print(f"a map's revision, {kind}: median {passed[4]:.2f} ms, first decile {passed[0]:.2f} ms, "
                  f"median of CPU {used[4]:.2f} ms", flush=True)  # fmt: skip
        common = {"REVISIT_ENCODER": given.encoder, "REVISIT_INLINE_WORKER": "false"}
        with ExitStack() as held:
            clients = {
                kind: held.enter_context(
                    serving(folder / kind, common if url is None else common | {"REVISIT_DATABASE": url})
                )
                for kind, url in urls.items()
            }
            took = queries(clients, streets, given.repeats)
        for column, what in enumerate(("as the caller sees it", "without the network")):
            first, second = (statistics.median(each[column] for each in took[kind]) for kind in urls)
            print(f"a query among {given.views:,} views {what}: {SQLITE} {first:.1f} ms, {POSTGRESQL} {second:.1f} ms, "
                  f"ratio {second / first:.2f}")  # fmt: skip
