"""A colour for every label, the same in all drawings and answers."""

import colorsys
import hashlib
from collections.abc import Mapping

Colour = tuple[int, int, int]

_USUAL: Mapping[str, Colour] = {
    "road": (115, 85, 130),
    "sidewalk": (215, 130, 205),
    "ground": (150, 120, 100),
    "parking": (180, 150, 200),
    "building": (150, 90, 70),
    "house": (180, 110, 80),
    "wall": (175, 160, 140),
    "fence": (190, 150, 110),
    "pole": (90, 95, 105),
    "traffic light": (250, 190, 40),
    "traffic sign": (235, 225, 70),
    "vegetation": (60, 130, 50),
    "tree": (40, 105, 45),
    "trunk": (95, 65, 40),
    "terrain": (150, 190, 95),
    "grass": (125, 200, 80),
    "sky": (110, 170, 225),
    "person": (220, 40, 60),
    "cyclist": (250, 90, 140),
    "car": (20, 40, 160),
    "vehicle": (30, 70, 190),
    "truck": (10, 20, 100),
    "bus": (0, 110, 140),
    "motorcycle": (80, 0, 200),
    "bicycle": (150, 20, 60),
    "window": (120, 215, 230),
    "door": (210, 150, 60),
    "floor": (200, 180, 150),
    "ceiling": (225, 225, 235),
    "furniture": (160, 100, 160),
    "other": (128, 128, 128),
}


def colour(label: str) -> Colour:
    """RGB of a label: from a table for common ones, otherwise from a hash of its text."""
    if label in _USUAL:
        return _USUAL[label]
    digest = hashlib.sha256(label.encode()).digest()
    red, green, blue = colorsys.hls_to_rgb(digest[0] / 256, 0.35 + digest[1] / 256 * 0.3, 0.5 + digest[2] / 256 * 0.4)
    return round(red * 255), round(green * 255), round(blue * 255)
