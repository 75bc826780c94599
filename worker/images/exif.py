"""Where and when a photo was taken, by its EXIF (Exif 2.32)."""

import math
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

from PIL import ExifTags, Image as PilImage

import worker.images.heic  # noqa: F401 (Pillow reads HEIC then)
from schemas.values import FARTHEST_M, whole_turn

Known = dict[str, Any]
"""What is known, by the names of `ViewAttributes` and `Position`."""


def taken(source: Path | BinaryIO) -> Known:
    """Position, heading and time of an image; empty without them.

    Parameters
    ----------
    source : Path or file

    Returns
    -------
    dict
        ``lat``, ``lon`` in degrees and ``alt`` in metres, ``heading`` in degrees clockwise from true north,
        ``captured_at`` with its zone; each only where it is known.
    """
    try:
        with PilImage.open(source) as pil_image:
            exif = pil_image.getexif()
            gps = exif.get_ifd(ExifTags.IFD.GPSInfo)
            camera = exif.get_ifd(ExifTags.IFD.Exif)
    except Exception:
        # Pillow's parsers raise errors of struct and others; whether the image is sound, its decoder says.
        return {}
    known: Known = {}
    if (point := _point(gps)) is not None:
        known |= {"lat": point[0], "lon": point[1]}
        height = _number(gps.get(6))
        if height is not None and abs(height) <= FARTHEST_M:
            known["alt"] = -height if gps.get(5) in (1, b"\x01") else height
    direction, kind = _number(gps.get(17)), gps.get(16)
    if direction is not None and kind != "M":  # M: magnetic, which is not north
        known["heading"] = whole_turn(direction % 360)  # of next to nothing below 0 the rest is 360.0
    if (moment := _taken(camera, gps)) is not None:
        known["captured_at"] = moment
    return known


def _point(gps: Mapping[int, Any]) -> tuple[float, float] | None:
    """Latitude and longitude in degrees; None where they are no point on the earth."""
    latitude = _degrees(gps.get(2), gps.get(1), "NS")
    longitude = _degrees(gps.get(4), gps.get(3), "EW")
    # Cameras without a GPS fix write 0, 0, which is a point in the sea.
    if latitude is None or longitude is None or (latitude, longitude) == (0.0, 0.0):
        return None
    return (latitude, longitude) if abs(latitude) <= 90 and abs(longitude) <= 180 else None


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None


def _degrees(value: Any, reference: Any, sides: str) -> float | None:
    """(degrees, minutes, seconds) as degrees, negative on the second of two sides; None where none is named.

    EXIF has no default for the side: without one a photo of Sydney would lie in the sea east of Japan.
    """
    named = reference.decode("latin-1") if isinstance(reference, bytes) else reference
    if not isinstance(value, Iterable) or not isinstance(named, str):
        return None
    parts = [_number(part) for part in value]
    side = named.strip("\0 ").upper()[:1]
    if len(parts) != 3 or any(part is None for part in parts) or not side or side not in sides:
        return None
    degrees: float = sum(part / 60.0**i for i, part in enumerate(parts) if part is not None)
    return -degrees if side == sides[1] else degrees


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
    except (TypeError, ValueError, OverflowError):  # OverflowError: the year 1 or 9999, and a zone that leads out of it
        return None
    return None
