"""Start modules of this project as processes that inherit next to nothing."""

import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]

INHERITED = ("PATH", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "LANG", "VIRTUAL_ENV", "PYTHONHOME", "TMPDIR")
"""Variables that they get: no keys, and nothing of the service's settings."""


def launched(
    module: str, arguments: Iterable[object], *, stdout: int, passed: tuple[int, ...] = ()
) -> "subprocess.Popen[bytes]":
    """Run a module with arguments as text and the descriptors `passed`; raises OSError.

    Not by `multiprocessing`, whose children import the main module, and so all of the service.
    """
    return subprocess.Popen(
        [sys.executable, "-W", "ignore", "-m", module, *map(str, arguments)],
        env={name: os.environ[name] for name in INHERITED if name in os.environ} | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=subprocess.DEVNULL,
        pass_fds=passed,
    )
