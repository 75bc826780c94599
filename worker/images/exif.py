"""Where and when a photo was taken, by its EXIF (Exif 2.32)."""

import math
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, BinaryIO

from PIL import ExifTags, Image as PilImage

import worker.images.heic  # noqa: F401 (Pillow reads HEIC then)
from schemas.values import FARTHEST_M, whole_turn

_BELOW = (1, 3, b"\x01", b"\x03")
"""References of heights below the ellipsoid, or below sea level (Exif 3.0)."""

Known = dict[str, Any]
"""What is known, by the names of `ViewAttributes` and `Position`."""


def read_exif(source: Path | BinaryIO) -> Known:
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
            known["alt"] = -height if gps.get(5) in _BELOW else height
    direction, kind = _number(gps.get(17)), _side(gps.get(16))
    if direction is not None and kind != "M":  # M: magnetic, which is not north
        known["heading"] = whole_turn(direction % 360)  # of next to nothing below 0 the rest is 360.0
    if (moment := _time(camera, gps)) is not None:
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
    side = _side(reference)
    if not isinstance(value, Iterable):
        return None
    parts = [_number(part) for part in value]
    if len(parts) != 3 or any(part is None for part in parts) or not side or side not in sides:
        return None
    degrees: float = sum(part / 60.0**i for i, part in enumerate(parts) if part is not None)
    return -degrees if side == sides[1] else degrees


def _side(reference: Any) -> str:
    """The letter of a reference, such as N, however it is written; empty where there is none."""
    return _text(reference).upper()[:1]


def _text(value: Any) -> str:
    """A text without what fills its field up; empty where there is none."""
    named = value.decode("latin-1") if isinstance(value, bytes) else value
    return named.strip("\0 ") if isinstance(named, str) else ""


def _time(exif: Mapping[int, Any], gps: Mapping[int, Any]) -> datetime | None:
    """Time of capture: the GPS time (UTC), or else the camera's clock when EXIF has its zone."""
    return _time_of_gps(gps) or _time_of_clock(exif)


def _time_of_gps(gps: Mapping[int, Any]) -> datetime | None:
    try:
        hours, minutes, seconds = (float(part) for part in gps[7])
        day = datetime.strptime(str(gps[29]), "%Y:%m:%d")
        moment = day.replace(hour=int(hours), minute=int(minutes), second=int(seconds), tzinfo=UTC)
        return moment + timedelta(microseconds=round(seconds % 1 * 1e6))
    except (KeyError, TypeError, ValueError, OverflowError, ZeroDivisionError):
        return None


def _time_of_clock(exif: Mapping[int, Any]) -> datetime | None:
    clock, zone = _text(exif.get(0x9003)), _text(exif.get(0x9011))
    if not clock or not zone:
        return None
    try:
        moment = datetime.strptime(f"{clock}{zone}", "%Y:%m:%d %H:%M:%S%z").astimezone(UTC)
    except (ValueError, OverflowError):  # OverflowError: the year 1 or 9999, and a zone that leads out of it
        return None
    digits = _text(exif.get(0x9291))  # behind the point of the seconds
    return moment.replace(microsecond=int(digits[:6].ljust(6, "0"))) if digits.isdecimal() else moment
