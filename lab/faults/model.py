"""``python -m lab.faults.model``: a service and a plain model of it live through the same operations and must agree.

A run is cut into episodes, each with a seed and an empty data folder of its own: a violation is replayed by the
episode's seed and the number of the operation, in at most some seconds.
"""

import argparse
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from lab.faults.comparing import compare_all
from lab.faults.damaging import Damaging, has_own_disk
from lab.faults.enrolling import MOST_VIEWS
from lab.faults.ledger import Violation
from lab.faults.live_service import QUICK, LiveService
from lab.faults.run import Progress, Tally, data_folder, parser, seed_of
from lab.faults.small_disk import NotMounted, small_disk

EPISODE = 1000
"""Operations in one life of a data folder."""

COMPARE_EVERY = 150
"""Operations between two comparisons of everything."""

DISK_MB, RESERVE_MB = 128, 4
"""Sizes of the disk that an episode has for itself, and of what the service keeps of it for deletions."""

WEIGHTS = {
    "enroll": 16.0,
    "enroll_and_query": 4.0,
    "enroll_unawaited": 7.0,
    "enroll_several": 2.0,
    "enroll_again": 5.0,
    "enroll_with_key": 1.5,
    "refused": 4.0,
    "query_own": 11.0,
    "query_filtered": 8.0,
    "query_unknown": 1.0,
    "patch": 12.0,
    "delete": 9.0,
    "delete_filtered": 2.0,
    "delete_map": 0.4,
    "put_map": 1.0,
    "change_ranking": 1.0,
    "switch_recipe": 0.4,
    "cancel_switch": 0.4,
    "begin_shadow": 0.4,
    "read_shadow": 1.0,
    "decide_shadow": 0.3,
    "list_pages": 6.0,
    "list_jobs": 2.0,
    "read": 6.0,
    "restore": 0.3,
    "restart": 0.1,
    "kill": 0.1,
    "kill_during": 0.3,
    "set_clock": 0.3,
    "damage_description": 0.3,
    "damage_attributes": 0.1,
    "damage_image": 0.1,
    "fill_disk": 0.1,
}
"""How often each operation is drawn, relative to the others."""


class Failed(Exception):
    """A violation in an episode, with what replays it."""


def live(data: Path, seed: int, operations: int, counts: Counter[str], without: Sequence[str] = ()) -> None:
    """One episode.

    Parameters
    ----------
    data : Path
        Empty. The disk is filled only where this is a file system of its own (`small_disk`).
    seed : int
        Of the episode.
    operations : int
    counts : Counter
        Gets what was done.
    without : sequence of str
        Names of operations that are left out.

    Raises
    ------
    Failed
        With the number of the operation and the last ones before it.
    """
    chance = np.random.default_rng(seed)
    left_out = {*without, *([] if has_own_disk(data) else ["fill_disk"])}
    names = [name for name in WEIGHTS if name not in left_out]
    shares = np.array([WEIGHTS[name] for name in names])
    served = LiveService(data, counts, told=True, settings={**QUICK, "REVISIT_RESERVE_MB": str(RESERVE_MB)})
    doing = Damaging(served, chance, counts)
    number = 0
    try:
        for number in range(1, operations + 1):
            name = str(chance.choice(names, p=shares / shares.sum()))
            if name.startswith("enroll") and sum(len(of.views) for of in doing.maps.values()) > 3 * MOST_VIEWS:
                name = "delete_filtered"
            operation: Callable[[], None] = getattr(doing, name)
            operation()
            counts[name] += 1
            _look(doing)
            if number % COMPARE_EVERY == 0 or number == operations:
                compare_all(served, doing.maps, page=int(chance.integers(1, 60)))
                counts["comparisons of everything"] += 1
        served.stop()
    except Exception as error:
        what = str(error) if isinstance(error, Violation) else traceback.format_exc()
        last = "\n".join(f"  {line}" for line in doing.log[-8:])
        raise Failed(
            f"operation {number}: {what}\nthe last operations:\n{last}\n"
            f"replay: python -m lab.faults.model --episode-seed {seed} --operations {number}"
        ) from error
    finally:
        served.close()


@contextmanager
def _disk(within: Path | None) -> Iterator[Path]:
    """A data folder on a small disk of its own, or without one where none can be mounted, which is said."""
    with data_folder(within) as data, ExitStack() as held:
        try:
            held.enter_context(small_disk(data, DISK_MB))
        except NotMounted as error:
            print(f"NOT DONE: fill_disk needs the right to mount a disk ({error})", file=sys.stderr, flush=True)
        yield data


def _look(doing: Damaging) -> None:
    """After every operation: one view is as acknowledged, one that was deleted is not there."""
    known = doing.some_view()
    if known is not None:
        known.compare(doing.served.json(f"/views/{known.id}"))
    if doing.deleted:
        gone = doing.deleted[int(doing.chance.integers(len(doing.deleted)))]
        doing.served.call("GET", f"/views/{gone}", 404)


def main(argv: Sequence[str] | None = None) -> int:
    """Run episodes; returns 1 after any violation."""
    options = parser("A service and a plain model of it live through the same operations and must agree.")
    options.add_argument("--operations", type=int, default=200_000, help="in all (default: 200000)")
    options.add_argument("--episode-seed", type=int, help="replay one episode, with --operations of it")
    options.add_argument("--without", nargs="*", default=[], choices=list(WEIGHTS), help="operations to leave out")
    arguments = options.parse_args(argv)
    if arguments.episode_seed is not None:
        return _replay(arguments)
    seed = seed_of(arguments)
    tally = Tally.resume(arguments.checkpoint, "model", seed)
    progress = Progress("model")
    episodes = -(-arguments.operations // EPISODE)
    for episode in range(tally.done, episodes):
        began = time.monotonic()
        count = min(EPISODE, arguments.operations - episode * EPISODE)
        with _disk(arguments.folder) as data:
            try:
                live(data, seed * 100_000 + episode, count, tally.counts, arguments.without)
            except Failed as failed:
                tally.violations.append(str(failed))
                print(f"VIOLATION: {failed}", file=sys.stderr, flush=True)
        tally.done = episode + 1
        tally.seconds += time.monotonic() - began
        tally.save(arguments.checkpoint)
        progress.tell(min(tally.done * EPISODE, arguments.operations), arguments.operations, tally.counts)
        if len(tally.violations) >= 10:
            break
    return tally.finish()


def _replay(arguments: argparse.Namespace) -> int:
    tally = Tally("model", arguments.episode_seed)
    began = time.monotonic()
    with _disk(arguments.folder) as data:
        try:
            live(data, arguments.episode_seed, min(EPISODE, arguments.operations), tally.counts, arguments.without)
        except Failed as failed:
            tally.violations.append(str(failed))
    tally.seconds = time.monotonic() - began
    return tally.finish()


if __name__ == "__main__":
    sys.exit(main())
