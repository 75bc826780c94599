"""Priority of threads whose work may wait."""

import os
import sys
import threading
from contextlib import suppress

LOWER = 10
"""Steps of nice(2), of 19, by which threads that step aside are below the others."""


def step_aside() -> None:
    """Let the other threads of the process go first where cores are short, from now on.

    On Linux, where each thread has a priority of its own; elsewhere nothing happens. Threads and processes that the
    calling thread starts inherit it, and without privilege it cannot be taken back.
    """
    if sys.platform == "linux":
        thread = threading.get_native_id()
        with suppress(OSError):  # refused by a sandbox: it is as fast as before
            os.setpriority(os.PRIO_PROCESS, thread, min(os.getpriority(os.PRIO_PROCESS, thread) + LOWER, 19))
