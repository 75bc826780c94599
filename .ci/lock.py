"""Write requirements.lock and requirements-dev.lock: ``python3 .ci/lock.py`` (Python 3.11, pip 23 or newer).

Asks pip what it would install for pyproject.toml and pins all of it, flat. The launcher installs these files with
``--no-deps``, so that nothing can come along that is not listed: on Linux torch's own metadata asks for 2.5 GB of CUDA
packages, which are left out here, and a local version such as ``+cpu`` is not written, because macOS has none.
"""

import json
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CUDA = re.compile(r"(nvidia|cuda|triton)\b|nvidia-", re.IGNORECASE)
HELD = ["torch==2.13.0"]
"""Not the newest: the version that weights and figures were made with. Raise it together with the benchmarks."""

HEAD = "# Made by `python3 .ci/lock.py`; do not edit. Install with `--no-deps`: the launcher does.\n"


def resolved(requirements: list[str]) -> dict[str, str]:
    """Name and version of everything that pip would install for these requirements on this machine."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed"]
        subprocess.run([*command, "--report", str(report), *requirements], check=True)
        items = json.loads(report.read_text())["install"]
    pins = {item["metadata"]["name"]: item["metadata"]["version"].partition("+")[0] for item in items}
    return {name.lower().replace("_", "-"): pins[name] for name in pins if not CUDA.match(name)}


def write(path: Path, pins: dict[str, str]) -> None:
    """Write pins, sorted by name."""
    path.write_text(HEAD + "".join(f"{name}=={pins[name]}\n" for name in sorted(pins)))
    print(f"{path.name}: {len(pins)} packages")


def main() -> None:
    """Resolve once with everything, so that both files agree, and split."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    everything = resolved([*project["dependencies"], *extras["dev"], *extras["lseg"], *HELD])
    pinned = [f"{name}=={version}" for name, version in everything.items()]
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as constraints:
        constraints.write("\n".join(pinned))
        constraints.flush()
        needed = resolved([*project["dependencies"], f"--constraint={constraints.name}"])
    write(ROOT / "requirements.lock", needed)
    write(ROOT / "requirements-dev.lock", {n: v for n, v in everything.items() if n not in needed})


if __name__ == "__main__":
    main()
