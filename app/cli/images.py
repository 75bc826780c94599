"""Finds images (files, folders, globs) and their attributes (CSV files of positions, EXIF)."""

import glob
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from app.cli.console import wrong_use

SUFFIXES = frozenset((".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff", ".heic", ".heif"))

Known = dict[str, Any]
"""Arguments of `Revisit.enroll` for one image."""


@dataclass(frozen=True)
class Skipped:
    """A file in a named folder that is not enrolled, and why."""

    path: Path
    reason: str


def found(paths: Sequence[str], skipped: list[Skipped] | None = None) -> list[Path]:
    """Images that files, folders (with all inside) and globs name, each once; sorted within each argument.

    What a folder has besides is added to `skipped`.

    Raises
    ------
    Failure
        A path does not exist, or holds no image.
    """
    images: dict[Path, None] = {}
    for text in paths:
        path = Path(text)
        if path.is_dir():
            files = sorted(p for p in path.rglob("*") if p.is_file() or p.is_symlink())
            reasons = {p: _not_taken(p) for p in files}
            inside = [p for p in files if reasons[p] is None]
            if skipped is not None:
                skipped += [Skipped(p, reason) for p, reason in reasons.items() if reason is not None]
        elif path.exists():
            inside = [path]  # a named file: the service judges it by content
        else:
            inside = sorted(Path(p) for p in glob.glob(text, recursive=True) if Path(p).is_file())
            if not inside and not glob.has_magic(text):
                wrong_use(f"{text}: there is no such file or folder")
        if not inside:
            wrong_use(f"{text}: no images there ({', '.join(sorted(SUFFIXES))})")
        images |= dict.fromkeys(inside)
    return list(images)


def _not_taken(path: Path) -> str | None:
    """Why a file in a folder is not enrolled; None when it is."""
    if not path.is_file():
        return "the link leads nowhere, or to a folder" if path.is_symlink() else "it is no file"
    kind = path.suffix.lower()
    if kind in SUFFIXES:
        return None
    return f"{kind or 'a name without an ending'} is no ending of an image"


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
        row = self._manifest.of(image.resolve().as_posix())
        if row is None:
            return None
        found = self._known[row.line]
        known = {"place": found.place, "captured_at": found.captured_at, **asdict(found.position)}
        return {name: value for name, value in known.items() if value is not None}

    def unused(self) -> list[str]:
        """`file` of the rows that `of` has not returned."""
        return sorted(row.file for row in self._manifest.unused())


def from_exif(path: Path) -> Known:
    """Position, heading and time of an image's EXIF; empty without them."""
    from PIL import ExifTags, UnidentifiedImageError
    from PIL import Image as PilImage

    import worker.images.heic  # noqa: F401 (Pillow reads HEIC then)

    try:
        with PilImage.open(path) as pil_image:
            exif = pil_image.getexif()
    except (UnidentifiedImageError, OSError):
        return {}  # the service says what is wrong with the file
    gps = exif.get_ifd(ExifTags.IFD.GPSInfo)
    known: Known = {}
    latitude = _degrees(gps.get(2), gps.get(1), "S")
    longitude = _degrees(gps.get(4), gps.get(3), "W")
    # Cameras without a GPS fix write 0, 0, which is a point in the sea.
    if latitude is not None and longitude is not None and (latitude, longitude) != (0.0, 0.0):
        known |= {"lat": latitude, "lon": longitude}
        if (height := _number(gps.get(6))) is not None:
            known["alt"] = -height if gps.get(5) in (1, b"\x01") else height
    direction, kind = _number(gps.get(17)), gps.get(16)
    if direction is not None and kind != "M":  # M: magnetic, which is not north
        known["heading"] = direction % 360
    if (taken := _taken(exif.get_ifd(ExifTags.IFD.Exif), gps)) is not None:
        known["captured_at"] = taken
    return known


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None


def _degrees(value: Any, reference: Any, negative: str) -> float | None:
    """(degrees, minutes, seconds) as degrees; negative when `reference` begins with `negative`."""
    if not isinstance(value, Iterable):
        return None
    parts = [_number(part) for part in value]
    if len(parts) != 3 or any(part is None for part in parts):
        return None
    degrees: float = sum(part / 60.0**i for i, part in enumerate(parts) if part is not None)
    return -degrees if str(reference).upper().startswith(negative) else degrees


def _taken(exif: Mapping[int, Any], gps: Mapping[int, Any]) -> datetime | None:
    """Time of capture: the GPS time (UTC), or the camera's clock when EXIF has its zone."""
    clock, zone = exif.get(0x9003), exif.get(0x9011)
    try:
        if gps.get(29) and gps.get(7):
            hours, minutes, seconds = (float(part) for part in gps[7])
            day = datetime.strptime(str(gps[29]), "%Y:%m:%d")
            return day.replace(hour=int(hours), minute=int(minutes), second=int(seconds), tzinfo=UTC)
        if clock and zone:
            return datetime.strptime(f"{clock}{zone}", "%Y:%m:%d %H:%M:%S%z").astimezone(UTC)
    except (TypeError, ValueError):
        return None
    return None
