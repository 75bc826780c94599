"""Waiting for what another thread or process does, on a machine that may have much else to do."""

import time
from collections.abc import Callable
from typing import TypeVar

PATIENCE_S = 60.0
"""How long anything may take that takes milliseconds where nothing else runs: only a failing test waits so long."""


T = TypeVar("T")


def until(true: Callable[[], T | None], patience_s: float = PATIENCE_S) -> T:
    """What it returns once that is true; fails when it is not true in time."""
    end = time.monotonic() + patience_s
    while not (found := true()):
        assert time.monotonic() < end, f"not true within {patience_s:.0f} s"
        time.sleep(0.01)
    return found


def advanced(look: Callable[[], T], done: Callable[[T], bool], patience_s: float = PATIENCE_S) -> T:
    """What `look` returns once it is `done`: that may take any time while it changes; fails once it stands still."""
    seen = look()
    end = time.monotonic() + patience_s
    while not done(seen):
        assert time.monotonic() < end, f"unchanged for {patience_s:.0f} s: {seen}"
        time.sleep(0.02)
        if (now := look()) != seen:
            seen, end = now, time.monotonic() + patience_s
    return seen
