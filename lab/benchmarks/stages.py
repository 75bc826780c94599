"""Where the time of enrolling and asking goes: ``./revisit benchmark stages [--views 1000 10000 100000]``.

Times are medians; every absolute time stands beside its ratio to a 512 x 512 x 512 float32 matrix product measured in
the same run on one thread, since machines differ and shared ones vary from minute to minute. Where the process shares
its cores with others, the CPU time beside it says more; it is that of all its threads.
"""

import argparse
import json
import platform
import resource
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from statistics import median

import cv2
import faiss
import numpy as np
from fastapi.testclient import TestClient
from worker.search.searcher import Searcher

from app.http.application import create_app
from lab.benchmarks.filling import fill
from scenes import scene
from schemas.description import Description
from schemas.image import Image
from schemas.records import Filters
from schemas.settings import Settings
from worker.description.describer import Describer
from worker.runtime import Runtime, build, make_product

SIZE = (640, 480)
NEAREST = 25
"""Candidates of each channel unless told otherwise: some 50 in all are re-ranked, as the aims have it."""
KINDS = ("street", "park", "corridor")


@dataclass(frozen=True)
class Row:
    """One measurement: what, at how many views (None: independent of them), and its median in milliseconds."""

    stage: str
    views: int | None
    ms: float
    cpu_ms: float | None = None


@dataclass(frozen=True)
class Took:
    """Milliseconds on the clock, and of all threads of this process."""

    wall: float
    cpu: float


def took(work: Callable[[], object]) -> Took:
    """How long a piece of work takes once."""
    began, used = time.perf_counter(), time.process_time()
    work()
    return Took((time.perf_counter() - began) * 1000, (time.process_time() - used) * 1000)


def milliseconds(work: Callable[[], object], repeats: int) -> Took:
    """Medians of a piece of work, after one warm-up."""
    work()
    times = [took(work) for _ in range(repeats)]
    return Took(median(t.wall for t in times), median(t.cpu for t in times))


def row(stage: str, views: int | None, time_taken: Took) -> Row:
    """A measurement with both times."""
    return Row(stage, views, time_taken.wall, time_taken.cpu)


def matrix_product(repeats: int = 50) -> Took:
    """The yardstick: 512 x 512 x 512 in float32 on one thread."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    left, right = torch.rand(512, 512), torch.rand(512, 512)
    unit = milliseconds(lambda: left @ right, repeats)
    torch.set_num_threads(threads)
    return unit


def drawn(count: int) -> list[bytes]:
    """JPEG pictures of drawn places."""
    images = []
    for number in range(count):
        pixels = scene(f"benchmark {number}", KINDS[number % len(KINDS)]).sized(*SIZE).pixels  # type: ignore[arg-type]
        encoded = cv2.imencode(".jpg", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 88])[1]
        images.append(encoded.tobytes())
    return images


def describing(runtime: Runtime, images: Sequence[bytes], repeats: int) -> list[Row]:
    """Stages that do not depend on the size of the map."""
    recipe = runtime.default_recipe
    describer = runtime.describers.of(recipe)
    decoded = [runtime.decode(data) for data in images]
    fields = [next(iter(runtime.encoder.encode([image]))) for image in decoded]
    turn = iter(range(10**9))

    def each(work: Callable[[int], object]) -> Took:
        return milliseconds(lambda: work(next(turn) % len(images)), repeats)

    rows = [
        row("decode", None, each(lambda i: runtime.decode(images[i]))),
        row("encode", None, each(lambda i: list(runtime.encoder.encode([decoded[i]])))),
        row("local features", None, each(lambda i: describer.keypoints(decoded[i]))),
    ]
    found = [describer.keypoints(image) for image in decoded]
    rows.append(row("describe", None, each(lambda i: describer.describe(decoded[i], fields[i], found[i]))))
    return rows


def enrolling(runtime: Runtime, client: TestClient, images: Sequence[bytes]) -> list[Row]:
    """Pictures through `/enroll`: one after the other, each to its answer; and all at once, per picture.

    Before them, in the same minute, what both are held against: the network and local features alone.
    """
    describer = runtime.describers.of(runtime.default_recipe)
    decoded = [runtime.decode(data) for data in images]

    def enroll(data: bytes, url: str, status: int) -> None:
        answer = client.post(url, content=data, headers={"content-type": "image/jpeg"})
        assert answer.status_code == status, answer.text

    def nothing_else() -> None:
        for image in decoded:
            list(runtime.encoder.encode([image]))
            describer.keypoints(image)

    described = threading.Semaphore(0)
    assert runtime.loop is not None
    runtime.loop.on_finish(lambda _: described.release())

    def at_once() -> None:
        for data in images:
            enroll(data, "/enroll?map=at-once&wait=false", 202)
        for _ in images:
            described.acquire()

    def one_by_one() -> None:
        for data in images:
            enroll(data, "/enroll", 201)

    nothing_else()
    rows = []
    for stage, work in (
        ("encode and local features", nothing_else),
        ("enroll, wait=false, all at once", at_once),
        ("enroll, one after the other", one_by_one),
    ):
        whole = took(work)
        rows.append(row(stage, None, Took(whole.wall / len(images), whole.cpu / len(images))))
    return rows


def described(runtime: Runtime, describer: Describer, image: Image) -> Description:
    """A description, made at once."""
    return describer.describe(image, next(iter(runtime.encoder.encode([image]))), describer.keypoints(image))


def asking(
    runtime: Runtime,
    client: TestClient,
    describer: Describer,
    data: bytes,
    views: int,
    repeats: int,
    nearest: int = NEAREST,
) -> list[Row]:
    """Stages that depend on the size of the map, at `views` views, with `nearest` candidates of each channel."""
    recipe = runtime.default_recipe
    image: Image = runtime.decode(data)
    description = described(runtime, describer, image)
    began = time.perf_counter()
    runtime.catalogue.index("default")
    rows = [Row("index from the database", views, (time.perf_counter() - began) * 1000)]
    index, _ = runtime.catalogue.index("default")
    selection = runtime.store.listings.select("default", Filters())
    changes = runtime.store.descriptions.since("default", 0)
    start = 0
    for name, channel in recipe.parameters.channels.items():
        bare = faiss.IndexFlatL2(channel.length)
        bare.add(np.ascontiguousarray(changes.vectors[:, start : start + channel.length]))
        start += channel.length
        alone = {name: description.vectors[name]}
        query = alone[name][None]
        rows += [
            row(f"bare FAISS, {name}", views, milliseconds(partial(bare.search, query, nearest), repeats)),
            row(f"search, {name}", views, milliseconds(partial(index.search, alone, nearest, selection), repeats)),
        ]
    stages: dict[str, list[Took]] = {"search": [], "rerank": [], "verify": []}
    product = make_product(runtime.settings)
    timers = [
        Searcher(runtime.store, runtime.catalogue, product, clock) for clock in (time.perf_counter, time.process_time)
    ]
    for _ in range(repeats):
        wall, cpu = (timer.search("default", recipe, description, Filters(), 5, nearest).timing_ms for timer in timers)
        for stage, times in stages.items():
            times.append(Took(wall[stage], cpu[stage]))
    for stage, times in stages.items():
        medians = Took(median(t.wall for t in times), median(t.cpu for t in times))
        rows.append(row(f"/query: {stage}", views, medians))

    def ask() -> dict[str, float]:
        url = f"/query?candidates={nearest}"
        answer = client.post(url, content=data, headers={"content-type": "image/jpeg"})
        assert answer.status_code == 200, answer.text
        stages_ms: dict[str, float] = answer.json()["timing_ms"]
        return stages_ms

    ask()
    whole, rest = [], []
    for _ in range(repeats):
        sent = time.perf_counter()
        stages_ms = ask()
        whole.append((time.perf_counter() - sent) * 1000)
        rest.append(whole[-1] - sum(v for k, v in stages_ms.items() if k != "total"))
    return [*rows, Row("/query: HTTP and the rest", views, median(rest)), Row("/query: all", views, median(whole))]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print a table, and write JSON if asked to."""
    parser = argparse.ArgumentParser(prog="revisit benchmark stages", description=__doc__)
    parser.add_argument("--views", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--encoder", default="compact", choices=("compact", "color"))
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--pictures", type=int, default=24)
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--nearest", type=int, default=NEAREST, help="candidates of each channel")
    parser.add_argument("--json", type=Path, help="also write the figures here")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data=Path(folder), encoder=options.encoder, threads=options.threads)
        runtime = build(settings)
        # In another process: drawing takes more memory than serving, and would be counted with it.
        with ProcessPoolExecutor(1, get_context("spawn")) as artist:
            images = artist.submit(drawn, options.images).result()
        describer = runtime.describers.of(runtime.default_recipe)
        rows = []
        with TestClient(create_app(runtime)) as client:
            yardstick = matrix_product()
            rows += enrolling(runtime, client, images)
            rows += describing(runtime, images, options.repeats)
            decoded = [runtime.decode(data) for data in images]
            seen = [described(runtime, describer, image) for image in decoded]
            there = len(images)
            for views in sorted(options.views):
                fill(settings.database_url, "default", runtime.default_recipe, seen, views - there, seed=views)
                there = views
                rows += asking(runtime, client, describer, images[0], views, options.repeats, options.nearest)
            # Whatever else the machine did in one of the two moments, it was not quicker than this.
            yardstick = min(yardstick, matrix_product(), key=lambda unit: unit.cpu)
        disk = sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file())
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    facts = {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "machine": platform.processor() or platform.machine(),
        "threads": options.threads,
        "matrix product ms": round(yardstick.wall, 2),
        "of CPU": round(yardstick.cpu, 2),
        "peak memory MB": round(memory),
        "disk MB": round(disk / 1e6),
        "onnxruntime": version("onnxruntime"),
        "torch": version("torch"),
        "faiss-cpu": version("faiss-cpu"),
        "numpy": version("numpy"),
    }
    print("  ".join(f"{name}: {value}" for name, value in facts.items()))
    print(f"{'stage':34}{'views':>9}{'ms':>10}{'ratio':>9}{'CPU ms':>10}{'ratio':>9}")
    for one in rows:
        at = "" if one.views is None else f"{one.views:,}"
        cpu = "" if one.cpu_ms is None else f"{one.cpu_ms:>10.2f}{one.cpu_ms / yardstick.cpu:>9.2f}"
        print(f"{one.stage:34}{at:>9}{one.ms:>10.2f}{one.ms / yardstick.wall:>9.2f}{cpu}")
    if options.json is not None:
        options.json.write_text(json.dumps({"facts": facts, "rows": [vars(one) for one in rows]}, indent=1))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
