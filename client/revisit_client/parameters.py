"""Converts arguments of the client's calls into parameters of HTTP requests."""

import json
import math
import os
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from urllib.parse import quote

from revisit_client import wire
from revisit_client.errors import Unsendable

Time = datetime | str

Image = bytes | str | os.PathLike[str]
"""The bytes of an image file (JPEG, PNG, WebP, BMP, TIFF, HEIC), or its path."""

LARGEST_FILE = 10**9
"""Bytes: a file that has more is not read, since it and its copies would fill the memory, and services take 25 MB."""


def named(image: Image) -> tuple[str | None, bytes]:
    """File name, None for bytes, and bytes of an image; raises Unsendable for a file of more than `LARGEST_FILE`."""
    if isinstance(image, bytes):
        return None, image
    path = Path(image)
    if (size := path.stat().st_size) > LARGEST_FILE:
        raise Unsendable(f"{path} has {size / 1e9:.1f} GB, and no file of more than 1 GB is sent as an image")
    return readable(path.name), path.read_bytes()


def zoom_between(field_of_view: float, of_map: float) -> float:
    """How many times as large a camera shows things as the one that took a map's images: `zoom` of a query.

    Parameters
    ----------
    field_of_view, of_map : float
        Degrees that either camera sees along the longer side of its image, more than 0 and less than 180. From a camera
        matrix, of an image that is wider than high: 2 atan(width / (2 fx)).

    Raises
    ------
    ValueError
    """
    if not (0 < field_of_view < 180 and 0 < of_map < 180):
        raise ValueError(
            f"fields of view are {field_of_view:g} and {of_map:g} degrees; needed: more than 0, less than 180"
        )
    return math.tan(math.radians(of_map) / 2) / math.tan(math.radians(field_of_view) / 2)


def readable(name: str) -> str:
    """A file name as text that can be sent: bytes that are no UTF-8, lone surrogates in Python, become such as %FF."""
    shown = "".join(f"%{ord(c) & 0xFF:02X}" if "\udc80" <= c <= "\udcff" else c for c in name)
    return shown.encode("utf-8", "replace").decode()


def utc(moment: datetime) -> datetime:
    """A time in UTC; one without a zone is taken as local time."""
    return moment.astimezone(UTC)


def address(*parts: str) -> str:
    """The path of a call; raises Unsendable for a name or id that is none.

    Names and ids come from anywhere: one with slashes or dots must not lead to another address.
    """
    for part in parts:
        if str(part) in ("", ".", "..") or any("\ud800" <= letter <= "\udfff" for letter in str(part)):
            raise Unsendable(f"{str(part)!r} is neither a name nor an id")
    return "".join(f"/{quote(str(part), safe='')}" for part in parts)


def header_text(value: str, what: str) -> str:
    """The value of a header; raises Unsendable for one that no header carries."""
    if not 1 <= len(value) <= 255 or not all("!" <= letter <= "~" for letter in value):
        raise Unsendable(f"{what} is {value[:100]!r}; it needs 1 to 255 visible ASCII characters")
    return value


def listed(values: Sequence[object] | str | None) -> str | None:
    """Values with commas between them, as text; text is taken as it is, and None stays None."""
    return values if values is None or isinstance(values, str) else ",".join(map(str, values))


def texts(values: Mapping[str, Any]) -> dict[str, str]:
    """Parameters as text; those that are None are left out."""
    written: dict[str, str] = {}
    for name, value in values.items():
        if value is None:
            continue
        if isinstance(value, bool):
            written[name] = "true" if value else "false"
        elif isinstance(value, datetime):
            written[name] = _moment(value)
        elif isinstance(value, Mapping):
            written[name] = json.dumps(value)
        else:
            written[name] = str(value)
    return written


def _moment(value: object) -> str:
    """A time as text; TypeError for what is none."""
    if not isinstance(value, datetime):
        raise TypeError(f"{value!r} cannot be written as JSON")
    return wire.rfc3339(utc(value))


def filters(
    near: tuple[float, float, float] | str | None,
    geographic: bool | None,
    after: Time | None,
    before: Time | None,
    place: str | None,
    metadata: Mapping[str, str] | None,
    where: Mapping[str, Any] | str | None,
    exclude_last: int | str | timedelta | None,
    exclude: Sequence[str] | str,
) -> dict[str, Any]:
    """Filters as parameters by name; None where not given. Raises Unsendable for metadata that is to be None."""
    nothing = [key for key, value in (metadata or {}).items() if value is None]
    if nothing:  # left out, the filter would let all views pass: to be deleted, say
        raise Unsendable(f"metadata {nothing[0]!r} is None, which no view has; leave it out, or use where=")
    if isinstance(exclude_last, timedelta):
        exclude_last = f"{exclude_last.total_seconds():.6f}".rstrip("0").rstrip(".") + "s"
    chosen: dict[str, Any] = {
        "near": listed(near),
        "frame": None if near is None or geographic is None else "geo" if geographic else "map",
        "after": after,
        "before": before,
        "place": place,
        "where": json.dumps(where, default=_moment) if isinstance(where, Mapping) else where,
        "exclude_last": exclude_last,
        "exclude": listed(exclude) or None,
    }
    return chosen | {f"metadata.{key}": value for key, value in (metadata or {}).items()}


def recipe_fields(
    labels: Sequence[str] | None,
    dynamic: Sequence[str] | None,
    preset: str | None,
    parameters: Mapping[str, Any] | None,
    ranking: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """The given fields of a map's recipe; the service chooses the others."""
    fields = {"labels": labels, "dynamic": dynamic, "preset": preset, "parameters": parameters, "ranking": ranking}
    return {name: value for name, value in fields.items() if value is not None}
