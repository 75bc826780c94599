"""The real service and the real worker as processes that can be stopped, killed and started again."""

import importlib
import multiprocessing
import os
import re
import signal
import sys
import tempfile
import time
from collections.abc import Mapping
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import TracebackType

import httpx

START_S = 60.0
"""Seconds within which a process must be ready; ten times what a busy machine needs."""

STOP_S = 60.0
"""Seconds within which a process must end after SIGTERM."""

PRELOADED = ("uvicorn", "uvicorn.lifespan.on", "uvicorn.protocols.http.h11_impl", "app.cli.serve", "app.cli.__main__",
             "app.http.application", "worker.runtime", "worker.encoders.color", "lab.faults.process")  # fmt: skip
"""What a started process would import: a process is forked from an interpreter that has it, which saves a second."""

_ADDRESS = re.compile(r"http://127\.0\.0\.1:\d+")

_warm = multiprocessing.get_context("forkserver")
_warm.set_forkserver_preload(list(PRELOADED))
_cold = multiprocessing.get_context("spawn")


class NotStarted(Exception):
    """A process ended before it was ready, or was not ready in time; the text has its output."""


def settings(data: Path, further: Mapping[str, str] | None = None) -> dict[str, str]:
    """The ``REVISIT_*`` variables of a process that needs no weights; `further` ones win."""
    return {
        "REVISIT_DATA": str(data),
        "REVISIT_ENCODER": "color",
        "REVISIT_PORT": "0",
        "REVISIT_THREADS": "1",
        **(further or {}),
    }


def _main(command: str, environment: Mapping[str, str], output: str, orders: Connection) -> None:
    """What the new process does: what ``./revisit COMMAND`` does, with its output in a file."""
    out = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for stream in (1, 2):
        os.dup2(out, stream)
    # Buffered lines of the parent must not appear twice; a killed process must not lose its own.
    sys.stdout = os.fdopen(1, "w", buffering=1, closefd=False)
    sys.stderr = os.fdopen(2, "w", buffering=1, closefd=False)
    for name in [name for name in os.environ if name.startswith("REVISIT_")]:
        del os.environ[name]
    os.environ.update(environment)
    if environment.get(TOLD):
        del os.environ[TOLD]
        importlib.import_module("lab.faults.injected").obey(orders)
    # By its name, as the interpreter would for `-m`: no study imports the interfaces.
    sys.exit(importlib.import_module("app.cli.__main__").main([command]))


TOLD = "REVISIT_TOLD"
"""Set when the process also obeys `lab.faults.injected`; no setting of the service."""


class Running:
    """A process of `revisit`, from its start until it is stopped or killed.

    Parameters
    ----------
    command : {'serve', 'worker', 'encode'}
    environment : mapping of str to str
        ``REVISIT_*`` variables; see `settings`.
    warm : bool
        Fork from an interpreter that has imported everything (0.2 s) instead of starting a new one (1.5 s).
    """

    def __init__(self, command: str, environment: Mapping[str, str], *, warm: bool = True) -> None:
        self._context = _warm if warm else _cold
        handle, name = tempfile.mkstemp(prefix="revisit-", suffix=".log")
        os.close(handle)
        self._log = Path(name)
        self.orders, theirs = self._context.Pipe()
        self._process: BaseProcess = self._context.Process(
            target=_main, args=(command, dict(environment), name, theirs), daemon=True
        )
        self._command = command
        self.began = time.perf_counter()
        self._process.start()
        theirs.close()
        self.url = ""

    @property
    def pid(self) -> int:
        """The process id."""
        assert self._process.pid is not None
        return self._process.pid

    @property
    def output(self) -> str:
        """All that it printed and logged."""
        return self._log.read_text(errors="replace")

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.is_alive()

    def await_ready(self) -> float:
        """Wait until it serves or encodes (or, a worker, describes); returns the seconds since the start.

        Raises
        ------
        NotStarted
        """
        wanted = re.compile("revisit worker describes") if self._command == "worker" else _ADDRESS
        until = time.monotonic() + START_S
        while (found := wanted.search(self.output)) is None:
            if not self.alive or time.monotonic() > until:
                raise NotStarted(f"`{self._command}` did not start:\n{self.output}")
            time.sleep(0.005)
        if self._command != "worker":
            self.url = found.group()
        return time.perf_counter() - self.began

    def stand_still(self) -> None:
        """SIGSTOP: it does nothing more until it is killed."""
        os.kill(self.pid, signal.SIGSTOP)

    def kill(self) -> None:
        """SIGKILL: no chance to tidy up."""
        self._process.kill()
        self._ended(STOP_S)

    def stop(self) -> int:
        """SIGTERM, and the exit code."""
        os.kill(self.pid, signal.SIGTERM)
        return self._ended(STOP_S)

    def _ended(self, within_s: float) -> int:
        self._process.join(within_s)
        if self._process.exitcode is None:
            self._process.kill()
            raise TimeoutError(f"`{self._command}` did not end within {within_s:.0f} s:\n{self.output[-4000:]}")
        return self._process.exitcode

    def close(self) -> None:
        """Kill it if it still runs, and remove its output."""
        if self.alive:
            self.kill()
        self.orders.close()
        self._log.unlink(missing_ok=True)

    def __enter__(self) -> "Running":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def serve(data: Path, further: Mapping[str, str] | None = None, *, warm: bool = True) -> Running:
    """A service that is ready, with `further` settings; raises NotStarted."""
    running = Running("serve", settings(data, further), warm=warm)
    try:
        running.await_ready()
    except BaseException:
        running.close()
        raise
    return running


def client(url: str, timeout_s: float = 60.0) -> httpx.Client:
    """A client with limits for every wait, which no proxy of the environment turns away."""
    return httpx.Client(base_url=url, timeout=timeout_s, trust_env=False)
