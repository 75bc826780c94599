"""Processes of `revisit` that are forked from an interpreter which has imported it: a start costs seconds otherwise."""

import importlib
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from multiprocessing.connection import Connection

from lab.faults.process import PRELOADED
from tests.described_once import describe_once
from tests.small_images import enlarge_less

_forked = multiprocessing.get_context("forkserver")
_forked.set_forkserver_preload([*PRELOADED, "boto3", "onnxruntime", "psycopg", "torch"])

READ_LATE = ("REVISIT_", "AWS_", "OTEL_")
"""Beginnings of the variables that nothing reads while it is imported: others need an interpreter of their own."""


def can_be_forked(variables: Mapping[str, str]) -> bool:
    """Whether a process with these variables besides ours may be forked from one that has imported everything."""
    return all(name.startswith(READ_LATE) for name in variables)


def _run(command: str, environment: Mapping[str, str], writing: Connection) -> None:
    """In the new process: what ``python -m app.cli COMMAND`` does."""
    for stream in (1, 2):
        os.dup2(writing.fileno(), stream)
    writing.close()
    sys.stdout = os.fdopen(1, "w", buffering=1, closefd=False)  # what the parent has buffered is not printed twice
    sys.stderr = os.fdopen(2, "w", buffering=1, closefd=False)
    os.environ.clear()
    os.environ.update(environment)
    enlarge_less()
    describe_once()
    sys.exit(importlib.import_module("app.cli.__main__").main([command]))


class Forked:
    """A process that is handled as a `subprocess.Popen` is.

    Parameters
    ----------
    command : {'serve', 'worker', 'encode'}
    environment : mapping of str to str
        All of its variables.
    """

    def __init__(self, command: str, environment: Mapping[str, str]) -> None:
        reading, writing = _forked.Pipe(duplex=False)
        self._process = _forked.Process(target=_run, args=(command, dict(environment), writing), daemon=True)
        self._process.start()
        writing.close()
        self.stdout = os.fdopen(os.dup(reading.fileno()), encoding="utf-8", errors="replace")
        reading.close()

    @property
    def pid(self) -> int:
        """Its process id."""
        assert self._process.pid is not None
        return self._process.pid

    def poll(self) -> int | None:
        """The exit code; None while it runs."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """The exit code, once it has ended; raises TimeoutExpired."""
        self._process.join(timeout)
        code = self.poll()
        if code is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout or 0)
        return code

    def send_signal(self, number: int) -> None:
        """Send a signal, unless it has ended."""
        if self.poll() is None:
            with suppress(ProcessLookupError):  # it has ended, and its exit code is on its way
                os.kill(self.pid, number)

    def kill(self) -> None:
        """SIGKILL."""
        self.send_signal(signal.SIGKILL)
