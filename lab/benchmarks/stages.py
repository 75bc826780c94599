"""Where the time of enrolling and querying goes: ``./revisit benchmark stages [--views 1000 10000 100000]``.

Times are medians; every absolute time stands beside its ratio to a 512 x 512 x 512 float32 matrix product measured in
the same run on one thread, since machines differ and shared ones vary from minute to minute. Where the process shares
its cores with others, the CPU time beside it says more; it is that of all its threads.
"""

import argparse
import json
import platform
import resource
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Self

import cv2
import faiss
import httpx
import numpy as np

from lab.benchmarks.filling import fill
from scenes import scene
from schemas.description import Description
from schemas.image import Image
from schemas.records import Filters
from schemas.settings import Settings
from worker.description.describer import Describer
from worker.method.cascade import Observe
from worker.method.evidence import Evidence
from worker.runtime import Runtime, build

SIZE = (640, 480)
NEAREST = 25
"""Candidates of each channel by default: some 50 in all are re-ranked."""
KINDS = ("street", "park", "corridor")

OverHttp = Callable[[Runtime], AbstractContextManager[httpx.Client]]
"""Starts a runtime and gives a client of its HTTP service; stops it afterwards."""


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

    @classmethod
    def now(cls) -> Self:
        """Readings whose differences are what something took."""
        return cls(time.perf_counter() * 1000, time.process_time() * 1000)

    def __sub__(self, earlier: "Took") -> "Took":
        return Took(self.wall - earlier.wall, self.cpu - earlier.cpu)


def took(work: Callable[[], object]) -> Took:
    """How long a piece of work takes once."""
    began = Took.now()
    work()
    return Took.now() - began


def medians(times: Sequence[Took]) -> Took:
    """Median of either time."""
    return Took(median(t.wall for t in times), median(t.cpu for t in times))


def milliseconds(work: Callable[[], object], repeats: int) -> Took:
    """Medians of a piece of work, after one warm-up."""
    work()
    return medians([took(work) for _ in range(repeats)])


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
    """JPEG images of drawn places."""
    images = []
    for number in range(count):
        pixels = scene(f"benchmark {number}", KINDS[number % len(KINDS)]).sized(*SIZE).pixels  # type: ignore[arg-type]
        encoded = cv2.imencode(".jpg", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 88])[1]
        images.append(encoded.tobytes())
    return images


def describing(runtime: Runtime, describer: Describer, images: Sequence[bytes], repeats: int) -> list[Row]:
    """Stages that do not depend on the size of the map."""
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


def enrolling(runtime: Runtime, client: httpx.Client, describer: Describer, images: Sequence[bytes]) -> list[Row]:
    """Images through `/enroll`: one after the other, each to its answer; and all at once, per image.

    Before them, in the same minute, what both are held against: the network and local features alone.
    """
    decoded = [runtime.decode(data) for data in images]

    def enroll(data: bytes, url: str) -> None:
        client.post(url, content=data, headers={"content-type": "image/jpeg"}).raise_for_status()

    def nothing_else() -> None:
        for image in decoded:
            list(runtime.encoder.encode([image]))
            describer.keypoints(image)

    described = threading.Semaphore(0)
    if runtime.loop is None:
        raise ValueError("a runtime without a worker describes nothing")
    runtime.loop.on_finish(lambda _: described.release())

    def at_once() -> None:
        for data in images:
            enroll(data, "/enroll?map=at-once&wait=false")
        for _ in images:
            described.acquire()

    def one_by_one() -> None:
        for data in images:
            enroll(data, "/enroll")

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


def searching(runtime: Runtime, description: Description, views: int, repeats: int, nearest: int) -> list[Row]:
    """The index, and the stages of a search, at `views` views, with `nearest` candidates of each channel."""
    recipe = runtime.default_recipe.description
    began = time.perf_counter()
    index, _ = runtime.catalogue.index("default")
    rows = [Row("index from the database", views, (time.perf_counter() - began) * 1000)]
    selection = runtime.store.listings.select("default", Filters())
    changes = runtime.store.descriptions.since("default", 0)
    start = 0
    for name, channel in recipe.parameters.channels.items():
        bare = faiss.IndexFlatL2(channel.length)
        bare.add(np.ascontiguousarray(changes.vectors[:, start : start + channel.length]))
        start += channel.length
        vector = {name: description.vectors[name]}
        rows += [
            row(f"bare FAISS, {name}", views, milliseconds(partial(bare.search, vector[name][None], nearest), repeats)),
            row(f"search, {name}", views, milliseconds(partial(index.search, vector, nearest, selection), repeats)),
        ]

    def search(observe: Observe) -> None:
        runtime.services.searcher.search(
            {"default": Filters()}, recipe, description, top=5, candidates=nearest, observe=observe
        )

    times = [stages_of(search) for _ in range(repeats)]
    return rows + [row(f"/query: {stage}", views, medians([t[stage] for t in times])) for stage in times[0]]


def stages_of(search: Callable[[Observe], object]) -> dict[str, Took]:
    """What the stages of a search take: ``search`` ends with the histograms, ``rerank`` with the cells in full."""
    ends: dict[str, Took] = {}

    def observe(stage: str, _: Evidence) -> None:
        ends[stage] = Took.now()

    began = Took.now()
    search(observe)
    ended, searched, compared = Took.now(), ends["histograms"], ends["full"]
    return {"search": searched - began, "rerank": compared - searched, "verify": ended - compared}


def querying(client: httpx.Client, data: bytes, views: int, repeats: int, nearest: int) -> list[Row]:
    """Whole calls of `/query` at `views` views."""

    def query() -> dict[str, float]:
        url = f"/query?candidates={nearest}"
        answer = client.post(url, content=data, headers={"content-type": "image/jpeg"}).raise_for_status()
        stages_ms: dict[str, float] = answer.json()["timing_ms"]
        return stages_ms

    query()
    whole, rest = [], []
    for _ in range(repeats):
        sent = time.perf_counter()
        stages_ms = query()
        whole.append((time.perf_counter() - sent) * 1000)
        rest.append(whole[-1] - sum(v for k, v in stages_ms.items() if k != "total"))
    return [Row("/query: HTTP and the rest", views, median(rest)), Row("/query: all", views, median(whole))]


def main(arguments: Sequence[str] | None = None, over_http: OverHttp | None = None) -> int:
    """Measure, print a table, and write JSON if wanted.

    Parameters
    ----------
    arguments : sequence of str, optional
    over_http : function, optional
        Given by `app`, which knows HTTP.
    """
    parser = argparse.ArgumentParser(prog="revisit benchmark stages", description=__doc__)
    parser.add_argument(
        "--views", type=int, nargs="+", default=[1000, 10_000, 100_000], help="sizes of the map that is queried"
    )
    parser.add_argument("--encoder", default="compact", choices=("compact", "color"), help="default: compact")
    parser.add_argument("--threads", type=int, default=0, help="threads of the network (default: one per core)")
    parser.add_argument("--images", type=int, default=24, help="images that are enrolled (default: 24)")
    parser.add_argument("--repeats", type=int, default=15, help="runs that a median is of (default: 15)")
    parser.add_argument("--nearest", type=int, default=NEAREST, help="candidates of each channel")
    parser.add_argument("--json", type=Path, help="also write the figures here")
    options = parser.parse_args(arguments)
    if over_http is None:
        print("whole calls are measured too: run `./revisit benchmark stages`", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data=Path(folder), encoder=options.encoder, threads=options.threads)
        runtime = build(settings)
        # In another process: drawing takes more memory than serving, and would be counted with it.
        with ProcessPoolExecutor(1, get_context("spawn")) as artist:
            images = artist.submit(drawn, options.images).result()
        recipe = runtime.default_recipe.description
        describer = runtime.describers.of(recipe)
        with over_http(runtime) as client:
            yardstick = matrix_product()
            rows = enrolling(runtime, client, describer, images)
            rows += describing(runtime, describer, images, options.repeats)
            descriptions = [_described(runtime, describer, runtime.decode(data)) for data in images]
            there = len(images)
            for views in sorted(options.views):
                fill(settings.database_url, "default", recipe, descriptions, views - there, seed=views)
                there = views
                rows += searching(runtime, descriptions[0], views, options.repeats, options.nearest)
                rows += querying(client, images[0], views, options.repeats, options.nearest)
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
        **{name: version(name) for name in ("onnxruntime", "torch", "faiss-cpu", "numpy")},
    }
    _print(facts, rows, yardstick)
    if options.json is not None:
        options.json.write_text(json.dumps({"facts": facts, "rows": [vars(one) for one in rows]}, indent=1))
    return 0


def _print(facts: Mapping[str, object], rows: Sequence[Row], yardstick: Took) -> None:
    print("  ".join(f"{name}: {value}" for name, value in facts.items()))
    print(f"{'stage':34}{'views':>9}{'ms':>10}{'ratio':>9}{'CPU ms':>10}{'ratio':>9}")
    for one in rows:
        at = "" if one.views is None else f"{one.views:,}"
        cpu = "" if one.cpu_ms is None else f"{one.cpu_ms:>10.2f}{one.cpu_ms / yardstick.cpu:>9.2f}"
        print(f"{one.stage:34}{at:>9}{one.ms:>10.2f}{one.ms / yardstick.wall:>9.2f}{cpu}")


def _described(runtime: Runtime, describer: Describer, image: Image) -> Description:
    """A description, made at once."""
    return describer.describe(image, next(iter(runtime.encoder.encode([image]))), describer.keypoints(image))
