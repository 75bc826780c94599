"""``python -m lab.faults.kills``: SIGKILL at random moments under full load, and nothing acknowledged is lost.

An episode is a life of one data folder: callers write, a process is killed, started, everything is checked, and so on.
"""

import argparse
import shutil
import sys
import threading
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from lab.faults.callers import SHARED, Caller
from lab.faults.comparing import compare_folder, views_of
from lab.faults.drawn import TYPE, image
from lab.faults.earlier import rewound
from lab.faults.enrolling import LABELS, LIGHT
from lab.faults.ext4_disk import Ext4Disk, ext4_disk
from lab.faults.ledger import Violation, require
from lab.faults.live_service import QUICK, LiveService
from lab.faults.process import NotStarted, Running, serve, settings
from lab.faults.run import Progress, Tally, data_folder, parser, seed_of
from lab.faults.small_disk import NotMounted

EPISODE = 50
"""Kills in one life of a data folder."""

CALLERS = 3
MOST_ACKNOWLEDGED = 15
"""Most acknowledged calls between two kills: moments that do not depend on how fast the machine is."""

STUCK_S = 30.0
"""Seconds within which the callers must get some answers."""

FILLING = 4
"""Rounds that fill a data folder before it is made an older one."""

KINDS = {"serve": 0.5, "worker": 0.15, "switch": 0.15, "migration": 0.1, "power": 0.1}
"""What is killed, and how many of the episodes that is: the service; a separate worker, the service, or both; the
service during a recipe switch; the service during the migration of an older database; the service and with it the power
of its disk, so that nothing is left of what was not synced."""


class Site:
    """A data folder, its processes and its callers.

    Parameters
    ----------
    data : Path
    kind : str
        A key of `KINDS`.
    seed : int
    counts : Counter
    disk : Ext4Disk or None
        Whose power is cut with each kill.
    """

    def __init__(self, data: Path, kind: str, seed: int, counts: Counter[str], disk: Ext4Disk | None = None) -> None:
        self.data, self.kind, self.counts, self._disk = data, kind, counts, disk
        self.chance = np.random.default_rng(seed)
        self.callers = [Caller(number, seed, worker_apart=kind == "worker") for number in range(1, CALLERS + 1)]
        apart = {"REVISIT_INLINE_WORKER": "false"} if kind == "worker" else {}
        small = {} if disk is None else {"REVISIT_RESERVE_MB": "4"}
        self.served = LiveService(data, counts, settings={**QUICK, **apart, **small})
        self.worker = self._hire()
        for name in (SHARED, *(caller.own for caller in self.callers)):
            self.served.call("PUT", f"/maps/{name}", 201, json={**LIGHT, "labels": LABELS[0], "dynamic": []})
        self._switch: str | None = None

    def _hire(self) -> Running | None:
        if self.kind != "worker":
            return None
        worker = Running("worker", settings(self.data, QUICK))
        worker.await_ready()
        return worker

    def kill_round(self) -> None:
        """Load, a kill at a random moment, a start."""
        if self.kind == "switch":
            labels = LABELS[int(self.chance.integers(2))]
            body = {"labels": labels, "dynamic": []}
            answer = self.served.call("POST", f"/maps/{SHARED}/recipe", 202, 409, json=body)
            self._switch = answer.json()["id"] if answer.status_code == 202 else self._switch
        gone = threading.Event()
        url = self.served.running.url
        threads = [threading.Thread(target=caller.work, args=(url, gone)) for caller in self.callers]
        for thread in threads:
            thread.start()
        self._await_acknowledged(int(self.chance.integers(MOST_ACKNOWLEDGED)))
        time.sleep(float(self.chance.uniform(0, 0.03)))
        doomed = "serve" if self.worker is None else str(self.chance.choice(["serve", "worker", "both"]))
        if self.worker is not None and doomed != "serve":
            self.worker.kill()
            self.worker.close()
        if self._disk is not None:
            self.served.running.stand_still()  # or it would answer that its disk fails
            self._disk.cut_power()
        if doomed != "worker":
            self.served.running.kill()
        gone.set()
        if doomed == "worker":
            self.worker = self._hire()  # first: callers may wait for a description
        for thread in threads:
            thread.join()
        if doomed != "worker":
            self.served.kill()
            if self._disk is not None:
                self._disk.mount_again()
            self.served.start()
        if doomed == "both":
            self.worker = self._hire()
        self.counts["kills"] += 1
        self.counts[f"kills of {'a service with a worker apart' if doomed == 'serve' and self.worker else doomed}"] += 1

    def _await_acknowledged(self, count: int) -> None:
        goal = count + sum(caller.counts.total() for caller in self.callers)
        until = time.monotonic() + STUCK_S
        while sum(caller.counts.total() for caller in self.callers) < goal:
            if time.monotonic() > until or all(caller.violations for caller in self.callers):
                break  # `check` says what the callers met; a service that answers nobody fails it too
            time.sleep(0.002)

    def check(self) -> None:
        """Everything that was acknowledged is there, and nothing else; raises Violation."""
        for caller in self.callers:
            require(not caller.violations, "; ".join(caller.violations))
        began = time.perf_counter()
        self.served.settle()
        if self._switch is not None:
            state, self._switch = self.served.await_job(self._switch), None
            require(state == "done", f"the recipe switch is {state}")
            self.counts["recipe switches that went on after a kill"] += 1
        shown = {view["id"]: view for view in views_of(self.served)}
        for caller in self.callers:
            caller.settle(shown)
        known = {view.id: view for caller in self.callers for view in caller.views.values()}
        missing, strange = sorted(known.keys() - shown.keys()), sorted(shown.keys() - known.keys())
        require(not missing, f"{len(missing)} acknowledged views are gone: {missing[:5]}")
        require(not strange, f"{len(strange)} views that were deleted or never sent: {strange[:5]}")
        for view_id, view in shown.items():
            known[view_id].compare(view)
            require(view["state"] == "ready", f"view {view_id} is {view['state']}: {view['failure']}")
        compare_folder(self.data, known.values())
        for caller in self.callers:
            self._search(caller)
        self.counts["views compared"] += len(shown)
        self.counts["ms of checking"] += round((time.perf_counter() - began) * 1000)

    def _search(self, caller: Caller) -> None:
        """What was written since the last kill is found, and what was deleted is not."""
        fresh = [view for view in dict.fromkeys(caller.touched) if view in caller.views][-4:]
        some = self.chance.choice(sorted(caller.views), min(2, len(caller.views)), replace=False)
        for view_id in dict.fromkeys([*fresh, *map(str, some)]):
            view = caller.views[view_id]
            given = {"map": view.map, "top": "1"}
            answer = self.served.call("POST", "/query", params=given, content=image(view.number), headers=TYPE).json()
            found = [match["view"]["id"] for match in answer["matches"]]
            require(found == [view_id], f"the image of view {view_id} found {found}")
            self.counts["views found"] += 1
        for view_id in caller.deleted[-3:]:
            self.served.call("GET", f"/views/{view_id}", 404)
            self.served.call("GET", f"/views/{view_id}/image", 404)
            self.counts["deleted views not found"] += 1
        caller.touched.clear()
        caller.deleted.clear()

    def close(self) -> None:
        """End the processes; adds what the callers did to the counts."""
        self.served.close()
        if self.worker is not None:
            self.worker.close()
        for caller in self.callers:
            self.counts.update(caller.counts)


def episode(data: Path, kind: str, seed: int, kills: int, counts: Counter[str]) -> None:
    """So many kills of one data folder; raises Violation, and NotMounted where no power can be cut."""
    with ExitStack() as held:
        disk = held.enter_context(ext4_disk(data)) if kind == "power" else None
        loaded = kind if kind in ("worker", "switch") else "serve"
        site = Site(data if disk is None else disk.at / "data", loaded, seed, counts, disk)
        held.callback(site.close)
        if kind == "migration":
            _migrations(site, kills)
            return
        for _ in range(kills):
            site.kill_round()
            site.check()


def _migrations(site: Site, kills: int) -> None:
    """Kill the service while it starts on a database of the tables before the newest."""
    for _ in range(FILLING):
        site.kill_round()
        site.check()
    site.served.stop()
    old = site.data.parent / f"{site.data.name}-old"
    try:
        rewound(site.data, old)
        for _ in range(kills - FILLING):
            shutil.rmtree(site.data)
            shutil.copytree(old, site.data)
            with Running("serve", settings(site.data, QUICK)) as starting:
                time.sleep(float(site.chance.uniform(0, 0.25)))
                starting.kill()
            site.counts["kills"] += 1
            site.counts["kills of a starting service that migrates"] += 1
            site.served.start()
            site.check()
            site.served.kill()
    finally:
        shutil.rmtree(old, ignore_errors=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Kill so many times; returns 1 after any violation."""
    options = parser("SIGKILL at random moments under full load, and nothing acknowledged is lost.")
    options.add_argument("--kills", type=int, default=3000, help="in all (default: 3000)")
    options.add_argument("--kind", choices=list(KINDS), help="only episodes of this kind (default: drawn)")
    arguments = options.parse_args(argv)
    seed = seed_of(arguments)
    tally = Tally.resume(arguments.checkpoint, "kills", seed)
    progress = Progress("kills")
    for number in range(tally.done, -(-arguments.kills // EPISODE)):
        began = time.monotonic()
        chance = np.random.default_rng([seed, number])
        kind = arguments.kind or str(chance.choice(list(KINDS), p=list(KINDS.values())))
        count = min(EPISODE, arguments.kills - number * EPISODE)
        with data_folder(arguments.folder) as data:
            try:
                episode(data, kind, seed * 100_000 + number, count, tally.counts)
            except NotMounted as error:
                print(f"NOT DONE: the power of a disk needs ext4 and the right to mount it ({error})", file=sys.stderr)
            except (Violation, NotStarted, TimeoutError) as error:
                text = f"episode {number} ({kind}): {error}; again: {_again(arguments, seed)}"
                tally.violations.append(text)
                print(f"VIOLATION: {text}", file=sys.stderr, flush=True)
        tally.done = number + 1
        tally.seconds += time.monotonic() - began
        tally.save(arguments.checkpoint)
        progress.tell(tally.counts["kills"], arguments.kills, tally.counts)
    tally.counts["ms of a start, mean"] = _start_ms(arguments.folder)
    return tally.finish()


def _again(arguments: argparse.Namespace, seed: int) -> str:
    return f"python -m lab.faults.kills --kills {arguments.kills} --seed {seed}"


def _start_ms(folder: Path | None) -> int:
    with data_folder(folder) as data, serve(data):
        pass
    with data_folder(folder) as data:
        began = time.perf_counter()
        with serve(data):
            return round((time.perf_counter() - began) * 1000)


if __name__ == "__main__":
    sys.exit(main())
