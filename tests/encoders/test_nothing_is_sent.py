"""ONNX Runtime reports nothing to its maker, which it would from its import on."""

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = "from worker.search.byte_product import byte_product; byte_product()"


def test_onnx_runtime_keeps_no_id_and_no_events(tmp_path: Path) -> None:
    inherited = {name: value for name, value in os.environ.items() if name not in ("ORT_DISABLE_TELEMETRY", "CI")}
    homes = {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}

    subprocess.run([sys.executable, "-c", PROGRAM], env=inherited | homes, check=True)

    assert list(tmp_path.rglob("*")) == []
