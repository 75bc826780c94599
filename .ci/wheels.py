"""Say for each line of requirements.lock which wheel 64-bit ARM installs: ``.venv/bin/python .ci/wheels.py``.

It asks pip, and so the indexes that pip is configured with, for the platform below instead of this one; torch also
where the launcher gets it. A wheel counts when its SHA-256 is one that the lock lists, as when it is installed. Needs a
network; wheels of which an index tells nothing more are fetched (some 500 MB) and thrown away. Exit code 1 when a line
has no wheel, with what pip said. ``--machine x86_64`` and ``--python 3.13`` ask for others.
"""

import argparse
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from packaging.markers import Marker

ROOT = Path(__file__).resolve().parent.parent
GLIBC = range(17, 37)
"""Minor versions of glibc 2 that wheels may be built for: Debian 12, the image's base, has 2.36."""


def lines_of(lock: str, machine: str, python: str) -> dict[str, str]:
    """The lines of a lock that are meant for Linux on a machine, with their hashes, by ``name==version``."""
    there = {"sys_platform": "linux", "platform_system": "Linux", "os_name": "posix", "platform_machine": machine}
    there |= {"implementation_name": "cpython", "platform_python_implementation": "CPython"}
    there |= {"python_version": python, "python_full_version": f"{python}.0"}
    found = {}
    for name, marker, hashes in re.findall(
        r"^([\w.+-]+==\S+)(?: ; (.*?))? \\\n((?:    --hash=.*\n?)+)", lock, re.MULTILINE
    ):
        if not marker or Marker(marker).evaluate(there):
            found[name] = f"{name} \\\n{hashes}"
    return found


def wheel(line: str, machine: str, python: str, *options: str) -> tuple[str | None, str]:
    """The name of the wheel that pip would install for a line, or None; and what pip said."""
    platforms = [f"manylinux_2_{minor}_{machine}" for minor in reversed(GLIBC)]
    platforms += [f"manylinux2014_{machine}", f"linux_{machine}"]
    with tempfile.TemporaryDirectory() as folder:
        wanted, report = Path(folder, "wanted.txt"), Path(folder, "report.json")
        wanted.write_text(line)
        command = [sys.executable, "-m", "pip", "install", "--dry-run", "--quiet", "--no-deps", "--require-hashes"]
        command += ["--only-binary=:all:", "--implementation=cp", f"--python-version={python}"]
        command += [f"--platform={each}" for each in platforms]
        command += [f"--target={folder}/site", f"--report={report}", f"--requirement={wanted}", *options]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            return None, done.stderr
        (item,) = json.loads(report.read_text())["install"]
        return item["download_info"]["url"].rpartition("/")[2], done.stderr


def main() -> int:
    """Print a line for each line of the lock."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machine", default="aarch64")
    parser.add_argument("--python", default="3.11")
    parser.add_argument("--lock", type=Path, default=ROOT / "requirements.lock")
    given = parser.parse_args()
    for_torch = re.search(r"^CPU_WHEELS=(\S+)", (ROOT / "revisit").read_text(), re.MULTILINE)
    assert for_torch, "the launcher does not say where it gets torch"
    lines, missing = lines_of(given.lock.read_text(), given.machine, given.python), {}
    for name, line in lines.items():
        further = [f"--extra-index-url={for_torch[1]}"] if name.startswith("torch==") else []
        found, said = wheel(line, given.machine, given.python, *further)
        if found is None:
            missing[name] = said
        print(f"{name:32} {found or 'NO WHEEL'}", flush=True)
    for name, said in missing.items():
        print(f"\n{name}:\n{said.strip()}", file=sys.stderr)
    target = f"Linux on {given.machine}, CPython {given.python}"
    print(f"{len(lines) - len(missing)} of {len(lines)} lines have a wheel for {target}")
    return 1 if missing or not lines else 0


if __name__ == "__main__":
    sys.exit(main())
