"""A container's share of a machine decides how many threads the network has, not the machine's size."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT
from worker.encoders.cores import usable_cores

MANY = 64
ONE = {min(os.sched_getaffinity(0))}


@pytest.fixture(autouse=True)
def large_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(MANY)))


def groups(folder: Path, own: str, **quotas: str) -> tuple[Path, Path]:
    """Where control groups are mounted, with some quotas by path (``__`` for ``/``), and the list of the process."""
    for name, quota in quotas.items():
        group = folder / "cgroup" / Path(*name.split("__"))
        group.mkdir(parents=True, exist_ok=True)
        if "cpu" in name.split("__"):
            for file, words in zip(("cpu.cfs_quota_us", "cpu.cfs_period_us"), quota.split(), strict=True):
                (group / file).write_text(f"{words}\n")
        else:
            (group / "cpu.max").write_text(f"{quota}\n")
    (folder / "own").write_text(own)
    return folder / "cgroup", folder / "own"


@pytest.mark.parametrize(
    ("own", "quotas", "cores"),
    [
        ("0::/\n", {".": "200000 100000"}, 2),  # docker run --cpus 2
        ("0::/\n", {".": "50000 100000"}, 1),  # --cpus 0.5
        ("0::/\n", {".": "150000 100000"}, 2),
        ("0::/\n", {".": "max 100000"}, MANY),
        ("0::/\n", {".": "9900000 100000"}, MANY),  # more than there are
        ("0::/system.slice/revisit.service\n", {"system.slice__revisit.service": "300000 100000"}, 3),  # CPUQuota=300%
        ("0::/a/b\n", {"a__b": "max 100000", "a": "400000 100000"}, 4),  # of the group that it lies in
        ("0::/../other\n", {".": "200000 100000", "other": "100000 100000"}, 2),  # seen from another namespace
        ("4:memory:/m\n1:cpu:/\n0::/\n", {"cpu": "250000 100000"}, 3),
        ("1:cpu:/docker/abc\n", {"cpu": "200000 100000"}, 2),  # whose own group is mounted as the root
        ("1:cpu:/docker/abc\n", {"cpu": "-1 100000", "cpu__docker__abc": "100000 50000"}, 2),
        ("1:cpu:/\n", {"cpu": "-1 100000"}, MANY),
        ("1:cpuset:/\n0::/\n", {"cpuset": "1 1"}, MANY),
        ("0::/\n", {".": "broken"}, MANY),
        ("", {}, MANY),
    ],
)
def test_a_quota_bounds_the_cores(tmp_path: Path, own: str, quotas: dict[str, str], cores: int) -> None:
    assert usable_cores(*groups(tmp_path, own, **quotas)) == cores


def test_elsewhere_the_machine_is_counted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    assert usable_cores(tmp_path / "no", tmp_path / "none") == 8


def test_a_process_that_is_bound_to_one_core_runs_the_network_on_one_thread(tmp_path: Path) -> None:
    told = subprocess.run(
        [sys.executable, "-m", "app.cli", "doctor", "--json", "--data", str(tmp_path)],
        cwd=ROOT,
        preexec_fn=lambda: os.sched_setaffinity(0, ONE),
        capture_output=True,
        text=True,
        check=False,
    )
    machine = json.loads(told.stdout)["machine"]
    assert (machine["cores"], machine["threads"]) == (1, 1)
