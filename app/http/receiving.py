"""Receives a large body into a file, in bounded memory."""

import asyncio
import uuid
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Protocol

from starlette.requests import Request

from app.http.body import announced_bytes

PIECE_BYTES = 1 << 20
"""Bytes that are written together."""

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


async def in_pieces(body: AsyncIterator[bytes]) -> AsyncIterator[bytes]:
    """A body in pieces that are worth a thread to write them."""
    piece = bytearray()
    async for chunk in body:
        piece += chunk
        if len(piece) >= PIECE_BYTES:
            yield bytes(piece)
            piece.clear()
    yield bytes(piece)


@asynccontextmanager
async def received(request: Request, receiver: Receiver) -> AsyncIterator[Path]:
    """Receive the body of a request into a file, which exists during the block; raises DiskFull."""
    path = await receiver.receiving(uuid.uuid4().hex, announced_bytes(request.headers))
    try:
        with path.open("xb") as file:
            written = 0
            async for piece in in_pieces(request.stream()):
                if written >= LOOK_EVERY:
                    await receiver.admit(written)
                    written = 0
                await asyncio.to_thread(file.write, piece)
                written += len(piece)
        yield path
    finally:
        await asyncio.to_thread(path.unlink, missing_ok=True)
