"""Attributes of images from what is known besides the manifest: their EXIF, and the direction of a panorama's view."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from schemas.records import Position, ViewAttributes
from worker.method.positions import is_known
from worker.service.recordings import Item

PLACE = ("lat", "lon", "alt", "heading")
"""What EXIF can say of a place."""


def wanted_of_exif(items: Sequence[Item]) -> frozenset[str]:
    """What EXIF may say of them: beside positions in metres no degrees."""
    metric = any(item.attributes.position.x is not None for item in items)
    return frozenset({"captured_at"} if metric else {"captured_at", *PLACE})


def completed(attributes: ViewAttributes, known: Mapping[str, Any]) -> ViewAttributes:
    """Attributes with what is known besides: a position where none was given, and the time.

    Parameters
    ----------
    attributes : ViewAttributes
        Of a manifest, which wins.
    known : mapping of our names to values
        Of the image's EXIF.
    """
    place = {name: known[name] for name in PLACE if name in known}
    given = attributes.position
    if given.heading is not None:  # by itself it says nothing of the point
        place["heading"] = given.heading
    position = given if is_known(given) else Position(**place)
    return replace(attributes, position=position, captured_at=attributes.captured_at or known.get("captured_at"))


def turned(attributes: ViewAttributes, degrees: float) -> ViewAttributes:
    """Attributes of a camera that is turned clockwise; a heading that is not known stays so."""
    heading = attributes.position.heading
    if heading is None or not degrees:
        return attributes
    return replace(attributes, position=replace(attributes.position, heading=(heading + degrees) % 360))
