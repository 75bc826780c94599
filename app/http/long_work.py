"""Threads of their own for what may take seconds or minutes.

Everything else shares asyncio's few: a handful of restorations in them would let every list wait, and so would as many
enrolments whose image store hangs, or that wait for others to write to the database.
"""

import asyncio
from collections.abc import Callable
from contextvars import copy_context
from functools import partial
from typing import ParamSpec, TypeVar

from schemas.threads import Threads

P = ParamSpec("P")
R = TypeVar("R")

AT_ONCE = 8
"""Restorations, drawings and the like that are under way together; what comes beyond waits."""


class LongWork:
    """Runs functions in threads of its own, `at_once` of them at most.

    Parameters
    ----------
    at_once : int or None
        None: as many as asyncio has.
    name : str
        Of the threads.
    """

    def __init__(self, at_once: int | None = AT_ONCE, name: str = "revisit-long-work") -> None:
        self._threads = Threads(at_once, name)

    async def run(self, call: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> R:
        """The result of a function that runs in one of the threads; as `asyncio.to_thread`."""
        call_in_context = partial(copy_context().run, call, *args, **kwargs)
        return await asyncio.get_running_loop().run_in_executor(self._threads, call_in_context)
