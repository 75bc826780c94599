"""Receives a large body into a file, in bounded memory."""

import asyncio
import uuid
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Protocol

from starlette.requests import Request

from app.http.body import announced_bytes

BUFFER = 1 << 20

LOOK_EVERY = 64 << 20
"""Bytes after which is looked again whether the disk has room."""


class Receiver(Protocol):
    """Where bodies are kept while they are received."""

    async def receiving(self, name: str, size: int) -> Path:
        """The file for a body that will have `size` bytes, 0 where that is unknown; raises DiskFull."""
        ...

    async def admit(self, size: int) -> None:
        """Raise DiskFull unless there is room for so many bytes more."""
        ...


@asynccontextmanager
async def received(request: Request, receiver: Receiver) -> AsyncIterator[Path]:
    """Receive the body of a request into a file, which exists during the block; raises DiskFull."""
    path = await receiver.receiving(uuid.uuid4().hex, announced_bytes(request.headers))
    try:
        with path.open("xb") as file:
            buffer, looked = bytearray(), 0
            async for chunk in request.stream():
                buffer += chunk
                if len(buffer) >= BUFFER:
                    await asyncio.to_thread(file.write, bytes(buffer))
                    looked += len(buffer)
                    buffer.clear()
                if looked >= LOOK_EVERY:
                    await receiver.admit(looked)
                    looked = 0
            await asyncio.to_thread(file.write, bytes(buffer))
        yield path
    finally:
        await asyncio.to_thread(path.unlink, missing_ok=True)
