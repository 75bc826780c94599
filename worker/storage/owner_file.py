"""The file that says of which database the images at a place are."""

from zlib import crc32

OWNER = "owner"
"""Name of the file."""


def written(owner: str) -> bytes:
    """The content of the file: the id of the database, and the CRC-32 of that."""
    return f"{owner} {crc32(owner.encode()):08x}\n".encode()


def read(content: bytes) -> str | None:
    """The id in the content of the file; None where the content is damaged."""
    owner, _, checksum = content.decode("utf-8", "replace").strip().partition(" ")
    return owner if owner and checksum == f"{crc32(owner.encode()):08x}" else None
