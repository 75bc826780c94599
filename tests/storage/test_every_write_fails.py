"""The disk or a quota is full at the n-th write, for every n: nothing half is left, and later all is as it was."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.failing_writes import failing_writes
from tests.storage.databases import data_folder

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("error", ["ENOSPC", "EDQUOT"])
def test_an_operation_is_done_or_undone_whichever_of_its_writes_fails(tmp_path: Path, error: str) -> None:
    with data_folder() as data, failing_writes(tmp_path, under=data) as faults:
        done = subprocess.run(
            [sys.executable, "-m", "tests.storage.every_write", str(data), error],
            cwd=ROOT,
            env=os.environ | faults.environment,
            capture_output=True,
            text=True,
            check=False,
        )
    assert done.returncode == 0, done.stderr
    writes = {line["operation"]: line["writes"] for line in map(json.loads, done.stdout.splitlines())}
    assert len(writes) == 20
    assert all(count >= 2 for count in writes.values()), f"some operation was not disturbed: {writes}"
    assert writes["enrol"] > 8  # image, folders, journal, and each made durable
