"""Runs a service as a process of its own for as long as a command needs it."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from app.cli.console import Failure

_URL = re.compile(r"revisit serves at (http://\S+)")
_OURS = (
    "REVISIT_HOST",
    "REVISIT_PORT",
    "REVISIT_OPEN",
    "REVISIT_DATABASE",
    "REVISIT_URL",
    "REVISIT_LOG",
    "REVISIT_KEY",
)
ROOT = Path(__file__).resolve().parents[2]
STARTING_S = 180
STOPPING_S = 30


@dataclass(frozen=True)
class Service:
    """A started service: its process and the file of its output."""

    log: Path
    process: "subprocess.Popen[bytes]"

    def url(self) -> str:
        """Wait until the service serves, and return its URL; raises Failure with the end of its log."""
        deadline = time.monotonic() + STARTING_S
        while time.monotonic() < deadline:
            if match := _URL.search(self.log.read_text(errors="replace")):
                return match[1]
            if self.process.poll() is not None:
                raise Failure(f"the service did not start:\n{self._end()}")
            time.sleep(0.05)
        raise Failure(f"the service did not start within {STARTING_S} s:\n{self._end()}")

    def _end(self) -> str:
        return "\n".join(self.log.read_text(errors="replace").splitlines()[-15:])


@contextmanager
def started(data: Path, log: Path) -> Iterator[Service]:
    """Context manager: start `serve` on a free port, with its output in `log`; stop it at the end."""
    env = {name: value for name, value in os.environ.items() if name not in _OURS}
    path = os.pathsep.join(filter(None, (str(ROOT), str(ROOT / "client"), env.get("PYTHONPATH"))))
    env |= {"REVISIT_DATA": str(data), "PYTHONUNBUFFERED": "1", "PYTHONPATH": path}
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "app.cli", "serve", "--port", "0", "--host", "127.0.0.1"],
            env=env,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C must reach the command alone, which then stops the service
        )
    try:
        yield Service(log, process)
    finally:
        process.terminate()
        try:
            process.wait(STOPPING_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
