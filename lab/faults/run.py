"""What every long run has: a seed that is printed, a checkpoint, a table at the end, and an exit code."""

import argparse
import json
import os
import platform
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from rich.console import Console
from rich.table import Table

LIBRARIES = ("fastapi", "uvicorn", "sqlalchemy", "numpy", "faiss-cpu", "opencv-python-headless")


@dataclass
class Tally:
    """What a run has done so far, kept in a file so that a run that is interrupted goes on.

    Parameters
    ----------
    name : str
    seed : int
    counts : Counter
        How often each thing was done.
    violations : list of str
    seconds : float
        That the run took, interruptions aside.
    done : int
        Episodes that are finished.
    """

    name: str
    seed: int
    counts: Counter[str] = field(default_factory=Counter)
    violations: list[str] = field(default_factory=list)
    seconds: float = 0.0
    done: int = 0

    def save(self, path: Path | None) -> None:
        """Write the checkpoint, whole or not at all."""
        if path is not None:
            unfinished = path.with_name(path.name + ".writing")
            unfinished.write_text(json.dumps(vars(self), indent=1))
            unfinished.replace(path)

    @classmethod
    def resume(cls, path: Path | None, name: str, seed: int) -> "Tally":
        """The checkpoint of the same run, or a new one."""
        if path is None or not path.exists():
            return cls(name, seed)
        kept = json.loads(path.read_text())
        if (kept["name"], kept["seed"]) != (name, seed):
            raise SystemExit(f"{path} is the checkpoint of {kept['name']} with seed {kept['seed']}; name another file")
        kept["counts"] = Counter(kept["counts"])
        return cls(**kept)

    def finish(self) -> int:
        """Print the table; returns the exit code: 1 after any violation."""
        table = Table(title=f"{self.name}, seed {self.seed}", title_justify="left")
        table.add_column("what")
        table.add_column("how often", justify="right")
        for what, often in self.counts.items():
            table.add_row(what, f"{often:,}")
        table.add_section()
        table.add_row("violations", str(len(self.violations)))
        Console(width=100).print(table)
        print(f"{self.seconds:.0f} s; {machine()}")
        for violation in self.violations:
            print(f"VIOLATION: {violation}")
        return 1 if self.violations else 0


def machine() -> str:
    """Date, versions and size of the machine, as the pages with figures give them."""
    versions = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    return f"{datetime.now(UTC):%Y-%m-%d}, {os.cpu_count()} cores, Python {platform.python_version()}, {versions}"


def parser(description: str) -> argparse.ArgumentParser:
    """A parser with the options that all runs have."""
    found = argparse.ArgumentParser(description=description)
    found.add_argument("--seed", type=int, default=None, help="replays a run; default: from the clock, printed")
    found.add_argument("--checkpoint", type=Path, help="file to go on from when the run is interrupted")
    found.add_argument("--folder", type=Path, help="where data folders are made (default: in memory, /dev/shm)")
    return found


def seed_of(arguments: argparse.Namespace) -> int:
    """The seed, printed."""
    seed = int(time.time()) % 1_000_000 if arguments.seed is None else int(arguments.seed)
    print(f"seed {seed}", flush=True)
    return seed


@contextmanager
def data_folder(within: Path | None) -> Iterator[Path]:
    """A new folder that is removed at the end; in memory when none is named: SIGKILL loses no page of either."""
    memory = Path("/dev/shm")
    folder = Path(tempfile.mkdtemp(prefix="revisit-faults-", dir=within or (memory if memory.is_dir() else None)))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


class Progress:
    """A line now and then on standard error."""

    def __init__(self, name: str, every_s: float = 30.0) -> None:
        self._name, self._every_s, self._last = name, every_s, time.monotonic()

    def tell(self, done: int, total: int, counts: Mapping[str, int]) -> None:
        """Print how far the run is, unless that was done a moment ago."""
        if time.monotonic() - self._last >= self._every_s:
            self._last = time.monotonic()
            some = ", ".join(f"{often} {what}" for what, often in list(counts.items())[:8])
            print(f"{self._name}: {done} of {total}; {some}", file=sys.stderr, flush=True)
