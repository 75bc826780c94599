"""The file that says of which database the images at a place are."""

from zlib import crc32

OWNER = "owner"
"""Its name."""


def written(owner: str) -> bytes:
    """Its content: the id of the database, and the CRC-32 of that."""
    return f"{owner} {crc32(owner.encode()):08x}\n".encode()


def read(content: bytes) -> str | None:
    """The id that it holds; None of one that is damaged: it says nothing."""
    owner, _, checksum = content.decode("utf-8", "replace").strip().partition(" ")
    return owner if owner and checksum == f"{crc32(owner.encode()):08x}" else None
