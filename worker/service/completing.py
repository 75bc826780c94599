"""Attributes of images, completed by their EXIF and by the direction in which a view of a panorama looks."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from schemas.records import Position, ViewAttributes
from worker.method.positions import is_known
from worker.service.recordings import Item

PLACE = ("lat", "lon", "alt", "heading")
"""What EXIF can say of a place."""


def wanted_of_exif(items: Sequence[Item]) -> frozenset[str]:
    """Names of what is taken from the EXIF of some items: no degrees where any of them has a position in metres."""
    metric = any(item.attributes.position.x is not None for item in items)
    return frozenset({"captured_at"} if metric else {"captured_at", *PLACE})


def completed(attributes: ViewAttributes, known: Mapping[str, Any]) -> ViewAttributes:
    """Attributes with the position and the time of an image's EXIF, where they have none of their own.

    Parameters
    ----------
    attributes : ViewAttributes
        As they were given.
    known : mapping of str to value
        What the EXIF says, by the names of attributes: those in `PLACE`, and ``captured_at``.
    """
    place = {name: known[name] for name in PLACE if name in known}
    given = attributes.position
    if given.heading is not None:  # by itself it says nothing of the point
        place["heading"] = given.heading
    position = given if is_known(given) else Position(**place)
    return replace(attributes, position=position, captured_at=attributes.captured_at or known.get("captured_at"))


def turned(attributes: ViewAttributes, degrees: float) -> ViewAttributes:
    """Attributes of a view that looks so many degrees further clockwise; a heading that is not known stays so."""
    heading = attributes.position.heading
    if heading is None or not degrees:
        return attributes
    return replace(attributes, position=replace(attributes.position, heading=(heading + degrees) % 360))
