"""What the service and a decoder's process say to each other: a fixed request, a short JSON reply, shared memory."""

import fcntl
import json
import mmap
import os
import socket
import struct
import tempfile
from dataclasses import dataclass
from typing import Any

READY = b"R"
DECODE, THUMBNAIL, READ_EXIF = 0, 1, 2

_REQUEST = struct.Struct("<BQI")
_LENGTH = struct.Struct("<I")
_PAGE = 4096


@dataclass(frozen=True)
class Request:
    """A request about the bytes at the start of the input memory.

    Parameters
    ----------
    kind : int
        DECODE, THUMBNAIL or READ_EXIF.
    length : int
        Of the encoded bytes.
    longest : int
        Longer side of a thumbnail, in pixels.
    """

    kind: int
    length: int
    longest: int = 0

    def send(self, to: socket.socket) -> None:
        """Write it."""
        to.sendall(_REQUEST.pack(self.kind, self.length, self.longest))

    @classmethod
    def receive(cls, by: socket.socket) -> "Request":
        """Read it; raises EOFError when the other side is gone."""
        return cls(*_REQUEST.unpack(_exactly(by, _REQUEST.size)))


def send_reply(to: socket.socket, reply: dict[str, Any]) -> None:
    """Write a reply."""
    text = json.dumps(reply).encode()
    to.sendall(_LENGTH.pack(len(text)) + text)


def receive_reply(by: socket.socket) -> dict[str, Any]:
    """Read a reply; raises EOFError when the other side is gone, TimeoutError."""
    (length,) = _LENGTH.unpack(_exactly(by, _LENGTH.size))
    reply: dict[str, Any] = json.loads(_exactly(by, min(length, 1 << 20)))
    return reply


def _exactly(by: socket.socket, count: int) -> bytes:
    parts = b""
    while len(parts) < count:
        part = by.recv(count - len(parts))
        if not part:
            raise EOFError
        parts += part
    return parts


def shared_memory(size: int) -> int:
    """A descriptor of `size` bytes of memory without a name, for both processes to map; untouched pages cost nothing.

    Sealed on Linux: a process that shrank it would end the other with SIGBUS. Elsewhere a deleted temporary file.
    """
    size = -(-size // _PAGE) * _PAGE
    if hasattr(os, "memfd_create"):
        number = os.memfd_create("revisit-decoder", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        os.ftruncate(number, size)
        fcntl.fcntl(number, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL)
        return number
    with tempfile.TemporaryFile() as file:
        number = os.dup(file.fileno())
    os.ftruncate(number, size)
    return number


def mapped(number: int) -> mmap.mmap:
    """All of the memory behind a descriptor."""
    return mmap.mmap(number, os.fstat(number).st_size)
