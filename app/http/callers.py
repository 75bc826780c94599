"""Callers who go before they are answered: a robot with a short timeout gives up, and asks again."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from fastapi import Request
from starlette.types import Receive

from worker.service.caller import Caller


@asynccontextmanager
async def caller_of(request: Request) -> AsyncIterator[Caller]:
    """The caller of a request whose body has been read; during the block their connection is watched.

    A client that shuts down its side alone is gone, too: uvicorn closes the other. One that has sent its next request
    already (HTTP/1.1 pipelining) may be seen to go only after the answer.
    """
    caller = Caller()
    watching = asyncio.create_task(_watch(request.receive, caller))
    try:
        yield caller
    finally:
        caller.leave()
        watching.cancel()
        await asyncio.wait([watching])


async def _watch(receive: Receive, caller: Caller) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass  # the end of the body may be told twice
    caller.leave()
