"""How many cores this process may use, which is fewer than the machine has in many containers."""

import os
from collections.abc import Iterator
from math import ceil
from pathlib import Path, PurePosixPath

CGROUPS = Path("/sys/fs/cgroup")
OWN = Path("/proc/self/cgroup")


def usable_cores(cgroups: Path = CGROUPS, own: Path = OWN) -> int:
    """Cores that the process is bound to, or as many as its control groups let it use of them, rounded up.

    A container that may use 2 of a machine's 64 cores sees all of them in ``os.cpu_count``. As many threads use up what
    it has in a moment, and then all of them stand still until the next tenth of a second.

    Parameters
    ----------
    cgroups : Path
        Where control groups are mounted: of version 1 (``cpu.cfs_quota_us``) or 2 (``cpu.max``), cgroups(7).
    own : Path
        Lists those of the process, as ``/proc/self/cgroup`` does.
    """
    bound = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min([bound, *map(ceil, _quotas(cgroups, own))]))


def _quotas(cgroups: Path, own: Path) -> Iterator[float]:
    """Cores that each control group above the process leaves it."""
    try:
        lines = own.read_text().splitlines()
    except OSError:  # no Linux
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if not controllers:
            yield from filter(None, map(_quota_2, _upwards(cgroups, path)))
        elif "cpu" in controllers.split(","):
            yield from filter(None, map(_quota_1, _upwards(cgroups / controllers, path)))


def _upwards(root: Path, path: str) -> Iterator[Path]:
    """A control group and those that it lies in; in a container its own may be the root."""
    inner = PurePosixPath(path.lstrip("/"))
    if ".." not in inner.parts:
        yield from (root / each for each in (inner, *inner.parents) if each.parts)
    yield root


def _quota_2(group: Path) -> float | None:
    return _share(_words(group / "cpu.max"))


def _quota_1(group: Path) -> float | None:
    return _share([*_words(group / "cpu.cfs_quota_us"), *_words(group / "cpu.cfs_period_us")])


def _words(file: Path) -> list[str]:
    try:
        return file.read_text().split()
    except OSError:
        return []


def _share(words: list[str]) -> float | None:
    """Of microseconds of CPU in a period, and its length; None where there is no quota (``max``, ``-1``)."""
    if len(words) != 2 or not all(word.isdecimal() for word in words) or words[1] == "0":
        return None
    return int(words[0]) / int(words[1])
