"""Time that only goes forward, whatever is done to the clock of the machine."""

import time
from datetime import UTC, datetime, timedelta

# Linux: counts while the machine sleeps, as a robot does between drives; elsewhere the next best.
_SOURCE = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)


def reading_s() -> float:
    """Seconds since an unknown moment, on a clock that nobody sets; for differences within this process."""
    return time.clock_gettime(_SOURCE)


_BEGAN = datetime.now(UTC), reading_s()


def now() -> datetime:
    """The time by the clock of the machine when this process began, and the seconds since: it never jumps."""
    began, reading = _BEGAN
    return began + timedelta(seconds=reading_s() - reading)
