"""The states of a job as server-sent events (WHATWG HTML, 9.2)."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import contextmanager

from fastapi.sse import KEEPALIVE_COMMENT, format_sse_event

from schemas.errors import RevisitError
from schemas.wire import Job

LOOK_S = 0.25
"""Seconds between two looks at a job."""

KEEP_ALIVE_S = 5.0
"""Seconds of silence after which a comment is sent: proxies keep the connection open, callers can look at the time."""

RECONNECT_MS, CROWDED_RECONNECT_MS = 1000, 5000
"""What browsers are told to wait before they connect again; where more follow jobs than may."""

MOST_FOLLOWERS = 64
"""Streams that look for changes: each does so four times a second, of its job and of its key."""

UNFINISHED = frozenset({"waiting", "running"})


class Followers:
    """How many follow jobs, so that what they look up is bounded by less than the connections."""

    def __init__(self, most: int = MOST_FOLLOWERS) -> None:
        self._most, self._count = most, 0

    @contextmanager
    def one_more(self) -> Iterator[bool]:
        """During the block there is one more; yields whether it may look for changes."""
        self._count += 1
        try:
            yield self._count <= self._most
        finally:
            self._count -= 1


async def job_events(
    job: Job,
    look: Callable[[], Awaitable[Job]],
    stopping: Callable[[], bool],
    followers: Followers,
    *,
    sleep: Callable[[float], Awaitable[object]] = asyncio.sleep,
) -> AsyncIterator[bytes]:
    """Events named ``job``: its present state, then each other one, the last being how it ended.

    Of one too many its present state alone: whoever connects again, as browsers and the Python client do, polls.

    Parameters
    ----------
    job : Job
        As it is now.
    look : function
        Reads the job. What it refuses ends the events: whoever connects again is told the reason.
    stopping : function
        Whether the service stops, which ends the events too.
    followers : Followers
    sleep : function
        For tests; seconds.

    Yields
    ------
    bytes
        An event or a comment, whole.
    """
    with followers.one_more() as may_look:
        yield _event(job, RECONNECT_MS if may_look else CROWDED_RECONNECT_MS)
        silent = 0.0
        while may_look and job.state in UNFINISHED and not stopping():
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


def _event(job: Job, again_ms: int = RECONNECT_MS) -> bytes:
    return format_sse_event(event="job", data_str=job.model_dump_json(), retry=again_ms)
