"""Runs a service as a process of its own for as long as a command needs it."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

from app.cli.output import Failure

_URL = re.compile(r"revisit serves at (http://\S+)")
_KEPT = frozenset((
    "encoder", "weights", "bpe", "lseg_mode", "encoder_url", "encoder_key", "device", "preset", "threads", "batch",
    "wait", "max_body_mb", "max_megapixels", "decoders", "decode_s", "log_level",
))  # fmt: skip
"""Settings of the user's that the service takes over: how images are read and described. Where data lie, who may call
and who is told are those of another service: one on a new database would take all images of its store for a crash's."""
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
def _told_to_end() -> Iterator[None]:
    """Context manager, of the main thread: a closed terminal or SIGTERM end it as an exception does."""

    def end(number: int, frame: FrameType | None) -> None:
        raise SystemExit(128 + number)

    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    for number in before:
        if before[number] == signal.SIG_DFL:  # nohup ignores SIGHUP
            signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def started(data: Path, log: Path) -> Iterator[Service]:
    """Context manager: start `serve` on a free port, with its output in `log`; stop it at the end, whatever ends it."""
    from schemas.settings import Settings

    others = {f"REVISIT_{name}".upper() for name in Settings.model_fields.keys() - _KEPT}
    env = {name: value for name, value in os.environ.items() if name not in others}
    path = os.pathsep.join(filter(None, (str(ROOT), str(ROOT / "client"), env.get("PYTHONPATH"))))
    env |= {"REVISIT_DATA": str(data), "PYTHONUNBUFFERED": "1", "PYTHONPATH": path}
    with _told_to_end(), _running(env, log) as process:
        yield Service(log, process)


@contextmanager
def _running(env: Mapping[str, str], log: Path) -> "Iterator[subprocess.Popen[bytes]]":
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", "app.cli", "serve", "--port", "0", "--host", "127.0.0.1"],
            env=env,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C must reach the command alone, which then stops the service
        )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(STOPPING_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
