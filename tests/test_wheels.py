"""`.ci/wheels.py` tells which lines of a lock have a wheel for another machine; here of wheels in a folder."""

import base64
import hashlib
import os
import subprocess
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[1]


def wheel(folder: Path, name: str, tag: str) -> str:
    """An empty wheel, and its line of a lock."""
    path = folder / f"{name}-1.0-{tag}.whl"
    pure = "true" if tag.endswith("any") else "false"
    files = {
        f"{name}-1.0.dist-info/METADATA": f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n",
        f"{name}-1.0.dist-info/WHEEL": f"Wheel-Version: 1.0\nRoot-Is-Purelib: {pure}\nTag: {tag}\n",
    }
    with zipfile.ZipFile(path, "w") as packed:
        record = ""
        for inside, text in files.items():
            packed.writestr(inside, text)
            digest = base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).decode().rstrip("=")
            record += f"{inside},sha256={digest},{len(text)}\n"
        packed.writestr(f"{name}-1.0.dist-info/RECORD", f"{record}{name}-1.0.dist-info/RECORD,,\n")
    return f"{name}==1.0 \\\n    --hash=sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}\n"


def test_lines_with_a_wheel_without_one_and_with_another_than_the_lock_lists(tmp_path: Path) -> None:
    lock = wheel(tmp_path, "anywhere", "py3-none-any")
    lock += wheel(tmp_path, "on_arm", "cp311-cp311-manylinux_2_28_aarch64")
    lock += wheel(tmp_path, "elsewhere", "cp311-cp311-manylinux_2_28_x86_64")
    lock += wheel(tmp_path, "exchanged", "py3-none-any").replace("sha256:", "sha256:0")[:-2] + "\n"
    lock += wheel(tmp_path, "windows", "py3-none-any").replace(" \\", " ; sys_platform == 'win32' \\", 1)
    (tmp_path / "requirements.lock").write_text(lock)
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PIP_")}

    run = subprocess.run(
        [sys.executable, str(ROOT / ".ci" / "wheels.py"), "--lock", str(tmp_path / "requirements.lock")],
        env=clean | {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(tmp_path), "PIP_CONFIG_FILE": os.devnull},
        capture_output=True, text=True, check=False,
    )  # fmt: skip

    told = dict(line.split(maxsplit=1) for line in run.stdout.splitlines()[:-1])
    assert told == {
        "anywhere==1.0": "anywhere-1.0-py3-none-any.whl",
        "on_arm==1.0": "on_arm-1.0-cp311-cp311-manylinux_2_28_aarch64.whl",
        "elsewhere==1.0": "NO WHEEL",
        "exchanged==1.0": "NO WHEEL",
    }, run.stderr
    assert run.stdout.splitlines()[-1] == "2 of 4 lines have a wheel for Linux on aarch64, CPython 3.11"
    assert run.returncode == 1
    assert "No matching distribution found for elsewhere==1.0" in run.stderr
