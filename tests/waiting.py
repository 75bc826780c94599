"""Waiting for what another thread or process does, on a machine that may have much else to do."""

import time
from collections.abc import Callable

PATIENCE_S = 60.0
"""How long anything may take that takes milliseconds where nothing else runs: only a failing test waits so long."""


def until(true: Callable[[], object], patience_s: float = PATIENCE_S) -> None:
    """Return once it is true; fails when it is not true in time."""
    end = time.monotonic() + patience_s
    while not true():
        assert time.monotonic() < end, f"not true within {patience_s:.0f} s"
        time.sleep(0.01)
