"""The states of a job as server-sent events (WHATWG HTML, 9.2)."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable

from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event

from schemas.errors import RevisitError
from schemas.wire import Job

LOOK_S = 0.25
"""Seconds between two looks at a job."""

KEEP_ALIVE_S = 5.0
"""Seconds of silence after which a comment is sent: proxies keep the connection open, callers can look at the time."""

RECONNECT_MS = 1000
"""What browsers are told to wait before they connect again."""

UNFINISHED = frozenset({"waiting", "running"})


async def job_events(
    job: Job,
    look: Callable[[], Awaitable[Job]],
    stopping: Callable[[], bool],
    *,
    sleep: Callable[[float], Awaitable[object]] = asyncio.sleep,
) -> AsyncIterator[bytes]:
    """Events named ``job``: its present state, then each other one, the last being how it ended.

    Parameters
    ----------
    job : Job
        As it is now.
    look : function
        Reads the job. What it refuses ends the events: whoever connects again is told the reason.
    stopping : function
        Whether the service stops, which ends the events too.
    sleep : function
        For tests; seconds.

    Yields
    ------
    bytes
        An event or a comment, whole.
    """
    yield _event(job)
    silent = 0.0
    while job.state in UNFINISHED and not stopping():
        await sleep(LOOK_S)
        silent += LOOK_S
        try:
            now = await look()
        except RevisitError:
            return
        if now != job:
            yield _event(now)
            silent = 0.0
        elif silent >= KEEP_ALIVE_S:
            yield KEEPALIVE_COMMENT
            silent = 0.0
        job = now


def _event(job: Job) -> bytes:
    return format_sse_event(event="job", data_str=job.model_dump_json(), retry=RECONNECT_MS)
