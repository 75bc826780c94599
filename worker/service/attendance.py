"""Which workers are alive: each gives signs of life, and watches the others'."""

import logging
import os
import platform
import secrets
import threading
import time
from collections.abc import Callable, Collection
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from schemas.errors import RevisitError
from schemas.records import WorkerRecord

log = logging.getLogger("revisit.worker")

ROUNDS = 5
"""Rounds without a sign of life after which a worker counts as dead."""

BOOT = Path("/proc/sys/kernel/random/boot_id")
"""Has an id that the system gave itself when it was started."""


class WorkerRows(Protocol):
    """Signs of life in the store."""

    def beat(self, worker: WorkerRecord, now: datetime) -> list[WorkerRecord]:
        """Give a sign of life; returns all workers."""
        ...

    def present(self) -> list[WorkerRecord]:
        """All workers that have a row."""
        ...

    def bury(self, names: Collection[str], now: datetime) -> int:
        """Remove workers, and put the jobs of workers without a row back; returns how many jobs."""
        ...


class AttendedStore(Protocol):
    """What attendance needs of the store."""

    @property
    def workers(self) -> WorkerRows:
        """Signs of life."""
        ...

    def tend(self) -> None:
        """Do what is due now and then."""
        ...


class Works(Protocol):
    """A loop that describes images."""

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        ...

    def wake_all(self) -> None:
        """Look for jobs at once."""
        ...


def this_process(kind: str, encoder: str) -> WorkerRecord:
    """A worker in this process with an encoder, under a name that no other process has or had."""
    host, pid = f"{platform.node()}/{_whose_process_ids()}", os.getpid()
    return WorkerRecord(f"{platform.node()}:{pid}:{secrets.token_hex(4)}", kind, host, pid, beats=0, encoder=encoder)


def _whose_process_ids() -> str:
    """Of which started system, and which container in it, the process ids are: several may have one name, as machines
    made from one image do; empty where that cannot be read."""
    try:
        return f"{BOOT.read_text().strip()}/{Path('/proc/self/ns/pid').readlink().name}"
    except OSError:
        return ""


class Attendance:
    """Gives signs of life in a thread of its own, also while its worker is busy, and finds out who gives none.

    No clock is compared: a worker is dead when its count stood still for `ROUNDS` rounds in which this one could write,
    or when its process, on this machine, is gone.

    Parameters
    ----------
    rows : WorkerRows
    me : WorkerRecord
        This process, from `this_process`.
    working : function or None
        Whether this process's worker works; None when it has none and only watches.
    every_s : float
        Seconds between rounds.
    each_round : function
        Called in every round.
    on_freed : function
        Called when jobs of dead workers were put back.
    """

    def __init__(
        self,
        rows: WorkerRows,
        me: WorkerRecord,
        *,
        working: Callable[[], bool] | None,
        every_s: float,
        each_round: Callable[[], None],
        on_freed: Callable[[], None],
    ) -> None:
        self._rows, self._me, self._working = rows, me, working
        self._every_s, self._each_round, self._on_freed = every_s, each_round, on_freed
        self._seen: dict[str, tuple[int, int]] = {}  # name: (count, rounds that it stood still)
        self._fresh: dict[str, float] = {}  # name: when its count last moved, of a monotonic clock
        self._able = 0
        self._encoder = str(me.encoder)  # also of workers of a version that did not say theirs, as far as is known
        self._others: set[str] = set()  # encoders of the workers that are not able
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="revisit-attendance", daemon=True)

    @classmethod
    def of(cls, store: "AttendedStore", me: WorkerRecord, loop: "Works | None", lease_s: float) -> "Attendance":
        """The attendance of a process with a store and, unless it only watches, a loop that describes images."""
        return cls(
            store.workers,
            me,
            working=None if loop is None else lambda: loop.alive,
            every_s=lease_s / ROUNDS,
            each_round=store.tend,
            on_freed=(lambda: None) if loop is None else loop.wake_all,
        )

    def ages_s(self) -> tuple[float, ...]:
        """Seconds since a sign of life of each worker was first seen, by this process's clock; 0 for a new one."""
        now = time.monotonic()
        return tuple(now - since for since in list(self._fresh.values()))

    @property
    def able(self) -> int:
        """Number of workers that are alive, and describe by the encoder of this process, as far as is known."""
        return max(self._able, int(self._working is not None and self._working()))

    @property
    def nobody(self) -> str | None:
        """Why nobody describes what is enrolled here, and what helps, in words; None while somebody does."""
        if self.able:
            return None
        if self._others:
            return (
                f"no worker is alive that describes by {self._encoder}, as this service does, only by "
                f"{', '.join(sorted(self._others))}: start one of the same version with the same REVISIT_ENCODER"
            )
        return (
            "no worker is alive to describe images: start one with `./revisit worker`, or `serve` without "
            "REVISIT_INLINE_WORKER=false"
        )

    def start(self, *, alone: bool = False) -> None:
        """Give the first sign of life, then go on in a thread.

        Parameters
        ----------
        alone : bool
            Whether no other service uses the database: the workers of services in it are dead predecessors then.
        """
        self._round(alone)
        self._thread.start()

    def stop(self) -> None:
        """Take this process's worker out, and end the thread."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        if self._working is not None:
            try:
                self._rows.bury([self._me.name], datetime.now(UTC))
            except RevisitError as error:
                log.warning("this worker could not sign off: %s", error)  # the others find out

    def _run(self) -> None:
        while not self._ended.wait(self._every_s):
            self._round()

    def _round(self, alone: bool = False) -> None:
        now = datetime.now(UTC)
        try:
            self._each_round()
            if self._working is None or (self._thread.ident is not None and not self._working()):
                rows = self._rows.present()
            else:
                rows = self._rows.beat(self._me, now)
            dead = self._dead(rows, alone)
            if self._rows.bury(dead, now):
                self._on_freed()
            if dead:
                log.warning("workers are gone: %s", ", ".join(sorted(dead)), extra={"event": "workers_gone"})
            encoders = [row.encoder or self._encoder for row in rows if row.name not in dead]
            self._able, self._others = encoders.count(self._encoder), set(encoders) - {self._encoder}
        except RevisitError:
            self._seen = {}  # nobody could write: their silence says nothing
        except Exception:
            self._seen = {}
            log.exception("signs of life could not be exchanged")

    def _dead(self, rows: list[WorkerRecord], alone: bool) -> set[str]:
        seen, self._seen = self._seen, {}
        fresh, now = self._fresh, time.monotonic()
        dead = set()
        for row in rows:
            count, still = seen.get(row.name, (-1, 0))
            self._seen[row.name] = row.beats, still + 1 if count == row.beats else 0
            mine = row.name == self._me.name
            predecessor = alone and row.kind == "serve"
            if not mine and (predecessor or self._gone(row) or self._seen[row.name][1] >= ROUNDS):
                dead.add(row.name)
        self._fresh = {
            row.name: now if self._seen[row.name][1] == 0 else fresh.get(row.name, now)
            for row in rows
            if row.name not in dead
        }
        own = self._seen.get(self._me.name)
        if own is not None and own[1] >= ROUNDS and self._working is not None:  # its thread has ended
            dead.add(self._me.name)
        return dead

    def _gone(self, row: WorkerRecord) -> bool:
        """Whether the process of a worker on this machine has ended."""
        if row.host != self._me.host or row.host.endswith("/"):
            return False
        try:
            os.kill(row.pid, 0)
        except ProcessLookupError:
            return True
        except OSError:  # it is there, and another user's
            pass
        return False
