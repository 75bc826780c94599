"""The files of the console: one page, its style and its modules, read once and served as they are."""

import hashlib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

STATIC = Path(__file__).with_name("static")

PAGE = "index.html"

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'"
)
"""Content-Security-Policy: scripts and styles from files of this service alone, nothing inline, no other host; images
also from what the scripts fetched with a key. No text can become markup (trusted types)."""

_TYPES = {".html": "text/html; charset=utf-8", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}


@dataclass(frozen=True)
class File:
    """A file of the console.

    Parameters
    ----------
    path : str
        Its address: ``/`` for the page, ``/console/NAME`` for what the page loads.
    data : bytes
    media_type : str
    etag : str
        Quoted, of the content.
    """

    path: str
    data: bytes
    media_type: str
    etag: str


@cache
def files() -> dict[str, File]:
    """All files by their address. No other address reads a file, so none can lead out of the folder."""
    found = (_read(path) for path in sorted(STATIC.iterdir()) if path.suffix in _TYPES)
    return {file.path: file for file in found}


def _read(path: Path) -> File:
    data = path.read_bytes()
    address = "/" if path.name == PAGE else f"/console/{path.name}"
    return File(address, data, _TYPES[path.suffix], f'"{hashlib.sha256(data).hexdigest()[:32]}"')
