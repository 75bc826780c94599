"""``./revisit benchmark living``: what filters, drives, recipe switches, snapshots and health cost in a large map.

A map of drawn places, many times over, each a little different (`lab.benchmarks.filling`). Every figure is a ratio, or
stands beside what it is held against, measured in turns with it in the same run:

- `filters`: a search with each filter against the one without, both from a description on, re-ranking included;
- `drive`: what a query takes longer as the next one of a drive, from the description on, in CPU time: other work on the
  machine disturbs that less;
- `switch`: the longest query while the map changes over to another recipe, by which all views are described already,
  against the median of the queries before it;
- `snapshot`: bytes a second, against a plain file of as many bytes, written and synced on the same disk;
- `health`: the report of a map that was not asked for it yet, and queries meanwhile against queries before.
"""

import argparse
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from functools import partial
from pathlib import Path
from statistics import median

from lab.benchmarks.filling import EPOCH, Keep, describe_anew, fill
from lab.benchmarks.stages import drawn
from schemas.description import Description
from schemas.records import Filters, ViewAttributes
from schemas.settings import Settings
from schemas.where import condition
from worker.description.presets import Wanted, make_recipe
from worker.method.decision import GROUPED, decide
from worker.runtime import Runtime, build
from worker.service.drives import Drives
from worker.storage.filter_cache import SETTLED_S
from worker.storage.image_files import Images

MAP = "default"
IMAGE_BYTES = 50_000
CHUNK = 1 << 20
PATIENCE_S, POLL_S = 600.0, 0.1
PARTS = ("filters", "drive", "switch", "snapshot", "health")


@dataclass(frozen=True)
class Row:
    """One figure: what it is, its value as text, and what it is held against."""

    what: str
    figure: str
    against: str


@dataclass
class Bench:
    """A map of `views` views, and what is queried.

    Parameters
    ----------
    runtime : Runtime
        Started.
    image : bytes
        What is queried.
    descriptions : sequence of Description
        By the map's recipe; the first is that of the image.
    views, repeats : int
    keep : function or None
        Stores what stands for the image of each view; None: there is none.
    """

    runtime: Runtime
    image: bytes
    descriptions: Sequence[Description]
    views: int
    repeats: int
    keep: Keep | None = None
    drives: Drives = field(init=False)

    def __post_init__(self) -> None:
        self.drives = Drives(self.runtime.services.searcher.further)

    def search(self, filters: Filters | None = None, top: int = GROUPED) -> object:
        """A search for the image, from its description on."""
        recipe = self.runtime.store.maps.get(MAP).description
        wanted = {MAP: Filters() if filters is None else filters}
        return self.runtime.services.searcher.search(wanted, recipe, self.descriptions[0], top=top)

    def decided(self, drive: str | None) -> None:
        """What a query does after its description, as one of a drive or alone."""
        recipe = self.runtime.store.maps.get(MAP).description
        results = self.runtime.services.searcher.search({MAP: Filters()}, recipe, self.descriptions[0], top=GROUPED)
        precision = results.recipe.ranking.precision
        decision = decide(
            results.ranking, results.levels, results.calibration, precision, searched=results.searched, shown=5
        )
        if drive is not None:
            self.drives.follow((MAP, drive), 60.0, results, decision)

    def grow(self) -> None:
        """Add a view, which is found from then on."""
        self.views += 1
        url, recipe = self.runtime.settings.database_url, self.runtime.store.maps.get(MAP).description
        fill(url, MAP, recipe, self.descriptions, 1, self.views, self.keep, IMAGE_BYTES)

    def query(self) -> float:
        """Milliseconds of a whole query, the network included."""
        return _ms(lambda: self.runtime.services.query.query(self.image, MAP))


def in_turns(
    works: Mapping[str, Callable[[], object]],
    repeats: int,
    clock: Callable[[], float] = time.perf_counter,
    first: Callable[[], object] = lambda: None,
) -> dict[str, list[float]]:
    """Milliseconds of several pieces of work, once each in every turn, after one warm-up of each.

    `first` is done before each of them, and not measured.
    """
    for work in works.values():
        work()
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repeats):
        for name, work in works.items():
            first()
            began = clock()
            work()
            times[name].append((clock() - began) * 1000)
    return times


def _ms(work: Callable[[], object]) -> float:
    began = time.perf_counter()
    work()
    return (time.perf_counter() - began) * 1000


def filters_of(views: int) -> dict[str, Filters]:
    """Filters to try, by what they let pass of a map of so many views."""
    half = views / 2
    return {
        "no filter": Filters(),
        "near, half of the map": Filters(near=(0.0, 0.0, half)),
        "near, 1 in 100": Filters(near=(0.0, 0.0, views / 100)),
        "after, half of the map": Filters(after=EPOCH + timedelta(seconds=half)),
        "place, one view": Filters(place=f"place {views // 3}"),
        "metadata.run, 1 in 10": Filters(metadata={"run": "3"}),
        "exclude_last=20": Filters(exclude_last=20),
        "where: a range of x, half": Filters(where=condition(f'{{"x": {{"$lt": {half}}}}}')),
        "where: metadata or a prefix": Filters(
            where=condition('{"$or": [{"metadata.run": {"$gte": 8}}, {"place": {"$prefix": "place 1"}}]}')
        ),
    }


def filters(bench: Bench) -> list[Row]:
    """A filtered search against the unfiltered one, in a map at rest and in one that is enrolled into all the while."""
    chosen = filters_of(bench.views)
    works = {name: partial(bench.search, one) for name, one in chosen.items()}
    time.sleep(SETTLED_S)
    for work in works.values():  # what a filter reads is read once it was wanted
        work()
        bench.runtime.store.listings.close()
    rows = []
    for state, first in (("", lambda: None), (", a view more each time", bench.grow)):
        times = in_turns(works, bench.repeats, first=first)
        plain = times.pop("no filter")
        rows.append(Row(f"search without a filter{state}", f"{median(plain):.1f} ms", ""))
        for name, found in times.items():
            ratio = median(one / other for one, other in zip(found, plain, strict=True))
            rows.append(Row(f"search, {name}{state}", f"{ratio:.2f}", "of the one without, at most 1.5"))
    return rows


def drive(bench: Bench) -> list[Row]:
    """What a drive adds to a query."""
    works = {"alone": lambda: bench.decided(None), "driven": lambda: bench.decided("robot")}
    times = in_turns(works, bench.repeats, time.thread_time)
    more = median(one - other for one, other in zip(times["driven"], times["alone"], strict=True))
    return [
        Row("search and decision of a query alone", f"{median(times['alone']):.1f} ms of CPU", ""),
        Row("as the next one of a drive", f"{more:+.2f} ms of CPU", "at most 1 ms more"),
    ]


def switch(bench: Bench) -> list[Row]:
    """The longest query while a map changes over."""
    runtime = bench.runtime
    record = runtime.store.maps.get(MAP)
    wanted = Wanted(labels=record.description.labels, dynamic=record.description.labels[:1])
    vocabulary = runtime.describers.of(record.description).vocabulary
    following = make_recipe(
        runtime.encoder, wanted, preset=record.ranking.preset, present=record.recipe, vocabulary=vocabulary
    ).description
    describe_anew(runtime.settings.database_url, MAP, following, bench.descriptions)
    before = [bench.query() for _ in range(bench.repeats)]
    during: list[float] = []
    over = threading.Event()

    def keep_querying() -> None:
        while not over.is_set():
            during.append(bench.query())

    asking = threading.Thread(target=keep_querying)
    asking.start()
    time.sleep(median(before) / 1000)
    took = _ms(lambda: runtime.services.maps.switch_recipe(MAP, wanted))
    if runtime.store.maps.get(MAP).description.id != following.id:
        raise SystemExit("the map did not change over at once")
    count = len(during)
    while len(during) < count + 5:  # the first queries by the new recipe read its index
        time.sleep(0.05)
    over.set()
    asking.join()
    usual = median(before)
    return [
        Row("query before the switch", f"{usual:.0f} ms", f"longest of {bench.repeats}: {max(before):.0f}"),
        Row("changing over, the call", f"{took:.0f} ms", ""),
        Row("longest query while it changes over", f"{max(during) / usual:.2f}", "of a query; one more is 2.0"),
    ]


def snapshot(bench: Bench) -> list[Row]:
    """A snapshot, as a job of the service makes it, against a plain file of as many bytes."""
    service, jobs, folder = bench.runtime.services.snapshots, bench.runtime.store.jobs, bench.runtime.settings.data
    plain, made, cpu = [], [], []
    size = 0
    for _ in range(3):
        began, working = time.perf_counter(), time.process_time()
        job = service.queue(MAP)
        while jobs.get(job.id).state in ("waiting", "running"):
            time.sleep(POLL_S)
        took, worked = time.perf_counter() - began, time.process_time() - working
        size = service.get(job.id).size
        cpu.append(size / worked / 1e6)
        made.append(size / took / 1e6)
        service.delete(job.id)
        plain.append(_written(folder / "plain", size))
    ratio = median(one / other for one, other in zip(made, plain, strict=True))
    return [
        Row("a plain file, written and synced", f"{median(plain):.0f} MB/s", f"{size / 1e6:.0f} MB"),
        Row("snapshot", f"{median(made):.0f} MB/s", f"{size / 1e6 / median(made):.0f} s"),
        Row("snapshot, of CPU time", f"{median(cpu):.0f} MB/s", "all that is computed, in three threads"),
        Row("snapshot", f"{ratio:.2f}", "of the disk's speed, at least 0.5"),
    ]


def _written(path: Path, size: int) -> float:
    """MB/s of writing a file and syncing it."""
    piece = os.urandom(CHUNK)
    began = time.perf_counter()
    with path.open("wb") as file:
        for _ in range(-(-size // CHUNK)):
            file.write(piece)
        file.flush()
        os.fsync(file.fileno())
    rate = size / (time.perf_counter() - began) / 1e6
    path.unlink()
    return rate


def health(bench: Bench) -> list[Row]:
    """The report, and queries meanwhile."""
    before = [bench.query() for _ in range(bench.repeats)]
    took: list[float] = []
    reporting = threading.Thread(target=lambda: took.append(_ms(lambda: bench.runtime.services.health.of(MAP))))
    reporting.start()
    meanwhile = []
    while reporting.is_alive():
        meanwhile.append(bench.query())
    reporting.join()
    slower = f"{median(meanwhile) / median(before):.2f}" if meanwhile else "none was asked meanwhile"
    return [
        Row("health, queried all the while", f"{took[0] / 1000:.1f} s", "within minutes"),
        Row("queries while the report is made", slower, f"of {median(before):.0f} ms; {len(meanwhile)} of them"),
    ]


MEASURES: Mapping[str, Callable[[Bench], list[Row]]] = {
    "filters": filters, "drive": drive, "switch": switch, "snapshot": snapshot, "health": health,
}  # fmt: skip


@contextmanager
def opened(
    settings: Settings, views: int, repeats: int, images: int, image_bytes: int | None = None
) -> Iterator[Bench]:
    """A service of its own with a map of `views` views, whose data folder and encoder are those of the settings.

    Parameters
    ----------
    settings : Settings
    views, repeats : int
    images : int
        Drawn places that the views are made of.
    image_bytes : int or None
        Of what stands for the image of each view; None: there is none.
    """
    runtime = build(settings.model_copy(update={"compare": False}))
    runtime.start()
    try:
        photos = drawn(images)
        for photo in photos:
            runtime.services.enroll.enroll(photo, MAP, ViewAttributes(), patience_s=PATIENCE_S)
        recipe = runtime.store.maps.get(MAP).description
        describer, searcher = runtime.describers.of(recipe), runtime.services.searcher
        descriptions = [searcher.describe(runtime.decode(photo), describer).value for photo in photos]
        keep = None if image_bytes is None else Images(settings.data / "pictures", set).add
        fill(settings.database_url, MAP, recipe, descriptions, views - images, views, keep, image_bytes or IMAGE_BYTES)
        bench = Bench(runtime, photos[0], descriptions, views, repeats, keep)
        bench.query()
        yield bench
    finally:
        runtime.stop()


def measured(
    settings: Settings, parts: Sequence[str], views: int, repeats: int, images: int, image_bytes: int = IMAGE_BYTES
) -> list[Row]:
    """Figures of some parts, by the keys of `MEASURES`; `switch` comes last, since it changes the map."""
    with opened(settings, views, repeats, images, image_bytes if "snapshot" in parts else None) as bench:
        return [row for part in sorted(parts, key=lambda part: part == "switch") for row in MEASURES[part](bench)]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="revisit benchmark living", description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--views", type=int, default=10_000, help="of the map (default: 10,000)")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--repeats", type=int, default=40, help="turns of each search and query (default: 40)")
    parser.add_argument("--images", type=int, default=24, help="drawn places (default: 24)")
    parser.add_argument("--encoder", default="compact", choices=("compact", "color"))
    parser.add_argument("--threads", type=int, default=1, help="threads of the network (default: 1)")
    parser.add_argument("--folder", type=Path, help="where the data folder is made: on the disk to be measured")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        settings = Settings(data=Path(folder), encoder=given.encoder, threads=given.threads)
        rows = measured(settings, given.parts, given.views, given.repeats, given.images)
    print(f"{given.views:,} views, encoder {given.encoder}, {given.threads} threads, {given.repeats} turns")
    print(f"load {os.getloadavg()[0]:.1f} at the end, {os.cpu_count()} cores\n")
    print("| | | held against |\n|---|---|---|")
    for row in rows:
        print(f"| {row.what} | {row.figure} | {row.against} |")


if __name__ == "__main__":
    main()
