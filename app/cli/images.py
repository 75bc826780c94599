"""Finds images (files, folders, globs) and their attributes (CSV files of positions)."""

import glob
import logging
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from app.cli.output import say, wrong_use
from schemas.values import in_order

SUFFIXES = frozenset((".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff", ".heic", ".heif"))

LARGEST, READING_S = 200, 20
"""Of an image whose EXIF is read: 10^6 bytes, and 10^6 pixels, at most, and seconds."""

Known = dict[str, Any]
"""Arguments of `Revisit.enroll` for one image."""


@dataclass(frozen=True)
class Skipped:
    """A file in a named folder that is not enrolled, and why."""

    path: Path
    reason: str


def find(paths: Sequence[str], skipped: list[Skipped] | None = None) -> list[Path]:
    """Images that files, folders (with all inside) and globs name, each once; within each argument by their names.

    What a folder has besides is added to `skipped`, but for what is hidden, by a dot: thumbnails, what macOS leaves
    beside each image, the store of git-annex.

    Raises
    ------
    Failure
        A path does not exist, or holds no image.
    """
    images: dict[Path, None] = {}
    for text in paths:
        path = Path(text)
        if path.is_dir():
            shown = [p for p in path.rglob("*") if not _is_hidden(p.relative_to(path))]
            files = sorted((p for p in shown if p.is_symlink() or not p.is_dir()), key=_in_order)
            reasons = {p: _not_taken(p) for p in files}
            inside = [p for p in files if reasons[p] is None]
            if skipped is not None:
                skipped += [Skipped(p, reason) for p, reason in reasons.items() if reason is not None]
        elif path.exists():
            inside = [path]  # a named file: the service judges it by content
        else:
            inside = sorted((Path(p) for p in glob.glob(text, recursive=True) if Path(p).is_file()), key=_in_order)
            if not inside and not glob.has_magic(text):
                wrong_use(f"{text}: there is no such file or folder")
        if not inside:
            wrong_use(f"{text}: no images there ({', '.join(sorted(SUFFIXES))})")
        images |= dict.fromkeys(inside)
    return list(images)


def absolute(path: Path) -> Path:
    """A path with all its folders, by the names that were given: links are not followed.

    Files that git-annex or DVC keep are links to files of other names.
    """
    return Path(os.path.abspath(path))


def _is_hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)


def _in_order(path: Path) -> list[tuple[object, ...]]:
    return [in_order(part) for part in path.parts]


def _not_taken(path: Path) -> str | None:
    """Why a file in a folder is not enrolled; None when it is."""
    if not path.is_file():
        return "the link leads nowhere, or to a folder" if path.is_symlink() else "it is a pipe, a socket or a device"
    kind = path.suffix.lower()
    if kind in SUFFIXES:
        return None
    return f"{kind or 'a name without an ending'} is no ending of an image"


@contextmanager
def exif_reader() -> Iterator[Callable[[Path], Known]]:
    """Context manager: a function that gives what the EXIF of an image says, as `worker.images.exif.read_exif`.

    In a process of its own, as the service reads it: one damaged file among thousands may end it.
    """
    from schemas.errors import BadImage, BodyTooLarge
    from worker.images.apart.pool import DecoderPool
    from worker.images.codec import MEGA, Limits

    logging.getLogger("worker.images").addHandler(logging.NullHandler())  # it is told below, with the file's name
    decoder = DecoderPool(1, Limits(LARGEST * MEGA, LARGEST * MEGA), READING_S)

    def read(path: Path) -> Known:
        try:
            if path.stat().st_size > LARGEST * MEGA:
                return {}  # and it is said when it is sent
            return decoder.read_exif(path.read_bytes())
        except BadImage as error:
            say(f"{path}: its EXIF is not read: {error.detail}")
        except (OSError, BodyTooLarge):
            pass  # which is said when it is sent
        return {}

    try:
        yield read
    finally:
        decoder.close()


class Positions:
    """A manifest: columns `file`, x,y[,z] or lat,lon[,alt], heading, place, captured_at, or their other names.

    A row belongs to the images whose path ends with its `file`. Positions in metres or degrees (WGS 84), heading in
    degrees clockwise from north. Raises Failure when the file cannot be used.
    """

    def __init__(self, path: Path) -> None:
        from worker.service import manifests

        self.path = path
        try:
            self._manifest = manifests.read_manifest(str(path), path.read_bytes())
            self._known = {row.line: manifests.attributes(row, str(path)) for row in self._manifest.rows}
        except FileNotFoundError:
            wrong_use(f"{path}: there is no such file or folder")
        except ValueError as error:
            wrong_use(str(error))
        if not set(self._manifest.columns) & manifests.NAMES.keys() - {"file"}:
            wrong_use(f"{path}: names no column beside file; some of {', '.join(manifests.NAMES)} are needed")
        if unknown := set(self._manifest.columns) - manifests.NAMES.keys():
            wrong_use(f"{path}: unknown columns {', '.join(sorted(unknown))}")

    def of(self, image: Path) -> Known | None:
        """The attributes of an image; None without a row."""
        row = self._manifest.of(absolute(image).as_posix())
        if row is None:
            return None
        found = self._known[row.line]
        known = {"place": found.place, "captured_at": found.captured_at, **asdict(found.position)}
        return {name: value for name, value in known.items() if value is not None}

    def unused(self) -> list[str]:
        """`file` of the rows that `of` has not returned."""
        return sorted(row.file for row in self._manifest.unused())
