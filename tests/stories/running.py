"""The real service, as a process of its own."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any

import httpx

from schemas.settings import Settings
from tests.storage.databases import put_tables
from tests.stories.warm import Forked, can_be_forked

ROOT = Path(__file__).resolve().parents[2]
LINES = 200
"""Last lines of a service's output that are shown when a test of it fails."""

START_S = 120

rows_of: Callable[[Path], str] | None = None
"""From a data folder to the URL of its database; None: SQLite in the folder. conftest.py sets it for each story."""


def settings(data: Path, **said: Any) -> Settings:
    """Settings of a service inside the test, whose rows lie where `rows_of` says, with the encoder without weights."""
    ours = {"data": data, "encoder": "color", "threads": 1}
    if "database" not in said:
        ours["database"] = _tables(data)
    return Settings.model_validate({**ours, **said})


def _tables(data: Path) -> str | None:
    """URL of the database with the rows of a data folder; None: it lies in the folder. It has its tables already."""
    if rows_of is not None:
        return rows_of(data)
    if not (data / "revisit.db").exists():
        put_tables(data)
    return None


def variables(data: Path, environment: Mapping[str, str] = MappingProxyType({})) -> dict[str, str]:
    """Variables of a process that needs no weights, with one decoder; `environment` goes before them.

    It compares no views in the background: a small map is compared anew with each further view, which takes more time
    than all else that happens to it here. A story that is about it, or about all that a service writes, says so.
    """
    ours = {"REVISIT_DATA": str(data), "REVISIT_ENCODER": "color", "REVISIT_THREADS": "1", "REVISIT_DECODERS": "1"}
    ours["REVISIT_COMPARE"] = "false"
    if "REVISIT_DATABASE" not in environment and (database := _tables(data)) is not None:
        ours["REVISIT_DATABASE"] = database
    clean = {k: v for k, v in os.environ.items() if not k.startswith("REVISIT_")}
    return {**clean, **ours, **environment}


def _started(
    command: str, data: Path, environment: Mapping[str, str], within: tuple[str, ...] = ()
) -> "Forked | subprocess.Popen[str]":
    """A process of `revisit`, all that it says in one stream."""
    whole = variables(data, environment)
    if not within and can_be_forked(environment):
        return Forked(command, whole)
    return subprocess.Popen(
        [*within, sys.executable, "-m", "app.cli", command],
        cwd=ROOT,
        env=whole,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


class RunningService:
    """`revisit serve` on a free port, with the encoder that needs no weights; subclasses run another command.

    Parameters
    ----------
    data : Path
        Its data folder.
    ready : bool
        Whether to wait until it is ready, not only until it listens.
    environment : str
        Further ``REVISIT_*`` variables.
    """

    command = "serve"
    within: tuple[str, ...] = ()
    """What the command is run by, such as ``ip netns exec NAME``."""

    def __init__(self, data: Path, ready: bool = True, /, **environment: str) -> None:
        self.data = data
        self._process = _started(self.command, data, {"REVISIT_PORT": "0", **environment}, self.within)
        self.output: list[str] = []
        self._address = threading.Event()
        self.url = ""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        if not self._address.wait(START_S) or not self.url:
            self.kill()
            raise AssertionError("the service did not start:\n" + "".join(self.output))
        if ready:
            self._await_readiness()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.output.append(line)
            found = re.search(r"revisit (?:serves|encodes) at (http://127\.0\.0\.1:\d+)", line)
            if found and not self.url:
                self.url = found[1]
                self._address.set()
        self._address.set()

    def _await_readiness(self) -> None:
        until = time.monotonic() + START_S
        while time.monotonic() < until:
            try:
                if httpx.get(f"{self.url}/readyz", timeout=5).status_code == 200:
                    return
            except httpx.TransportError:
                pass
            threading.Event().wait(0.05)
        raise AssertionError("the service did not become ready:\n" + "".join(self.output))

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def kill(self) -> None:
        """SIGKILL: no chance to tidy up."""
        self._process.send_signal(signal.SIGKILL)
        self._process.wait(30)
        self._close()

    def stop(self) -> int:
        """SIGTERM, and the exit code."""
        self._process.send_signal(signal.SIGTERM)
        code = self._process.wait(60)
        self._close()
        return code

    def signal(self, number: signal.Signals) -> None:
        """Send a signal and return at once."""
        self._process.send_signal(number)

    def wait(self, seconds: float = 60) -> int:
        """The exit code, once the process has ended by itself."""
        code = self._process.wait(seconds)
        self._close()
        return code

    def _close(self) -> None:
        self._reader.join(5)
        assert self._process.stdout is not None
        self._process.stdout.close()

    def __enter__(self) -> "RunningService":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.poll() is None:
            self.stop()
        if kind is not None:
            print("".join(self.output[-LINES:]))  # shown by pytest with the failure


class RunningEncoder(RunningService):
    """`revisit encode`, of the built-in encoder. It keeps nothing, so that there is no database to make."""

    command = "encode"

    def __init__(self, port: int = 0, ready: bool = True, /, **environment: str) -> None:
        ours = {
            "REVISIT_ENCODER": "compact",
            "REVISIT_PORT": str(port),
            "REVISIT_DATABASE": "sqlite:///nowhere/revisit.db",
        }
        super().__init__(ROOT, ready, **{**ours, **environment})


@contextmanager
def worker(data: Path, /, *within: str, **environment: str) -> Iterator["Forked | subprocess.Popen[str]"]:
    """`revisit worker` on a data folder, with the encoder that needs no weights; `within`: what runs the command."""
    process = _started("worker", data, environment, within)
    said: list[str] = []
    described = threading.Event()

    def read() -> None:  # to the end: a full pipe would stop it
        assert process.stdout is not None
        for line in process.stdout:
            said.append(line)
            if "describes" in line:
                described.set()
        described.set()

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    try:
        assert described.wait(START_S), "".join(said)
        assert process.poll() is None, "".join(said)
        yield process
    finally:
        process.kill()
        process.wait()
        reader.join(5)
        assert process.stdout is not None
        process.stdout.close()
