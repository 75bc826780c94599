"""Threads of their own for what may take seconds or minutes.

Everything else shares asyncio's few: a handful of restorations in them would let every enrolment and every list wait.
"""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from functools import partial
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

AT_ONCE = 8
"""What comes beyond waits for these."""


class LongWork:
    """Runs functions in these threads."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(AT_ONCE, "revisit-long-work")

    async def run(self, call: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> R:
        """As `asyncio.to_thread`."""
        call_in_context = partial(copy_context().run, call, *args, **kwargs)
        return await asyncio.get_running_loop().run_in_executor(self._threads, call_in_context)
