"""A service as a real process of its own, for as long as it is needed."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from app.cli.console import Failure

_URL = re.compile(r"revisit serves at (http://\S+)")
_OURS = ("REVISIT_HOST", "REVISIT_PORT", "REVISIT_OPEN", "REVISIT_DATABASE", "REVISIT_URL", "REVISIT_LOG")
STARTING_S = 180
STOPPING_S = 30


@dataclass(frozen=True)
class Service:
    """A running service."""

    url: str
    log: Path
    process: "subprocess.Popen[bytes]"


@contextmanager
def running(folder: Path, environment: Mapping[str, str] | None = None) -> Iterator[Service]:
    """Start `serve` on a free port with its data and its log in a folder; stop it at the end.

    Raises
    ------
    Failure
        It did not start; the text has the end of its log.
    """
    log = folder / "service.log"
    env = {name: value for name, value in os.environ.items() if name not in _OURS}
    env |= {"REVISIT_DATA": str(folder / "data"), "PYTHONUNBUFFERED": "1", **(environment or {})}
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "app.cli", "serve", "--port", "0", "--host", "127.0.0.1"],
            env=env,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C is for us; we stop the service ourselves
        )
    try:
        yield Service(_url(process, log), log, process)
    finally:
        process.terminate()
        try:
            process.wait(STOPPING_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _url(process: "subprocess.Popen[bytes]", log: Path) -> str:
    """Wait until the service says where it is."""
    deadline = time.monotonic() + STARTING_S
    while time.monotonic() < deadline:
        if match := _URL.search(log.read_text(errors="replace")):
            return match[1]
        if process.poll() is not None:
            raise Failure(f"the service did not start:\n{_end(log)}")
        time.sleep(0.05)
    raise Failure(f"the service did not start within {STARTING_S} s:\n{_end(log)}")


def _end(log: Path) -> str:
    return "\n".join(log.read_text(errors="replace").splitlines()[-15:])
