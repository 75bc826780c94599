"""What a map may blur in its images before they are stored."""

from collections.abc import Mapping

BLUR_GROUPS: Mapping[str, tuple[str, ...]] = {
    "people": ("person", "human", "cyclist", "bicyclist", "motorcyclist"),
    "vehicles": ("vehicle", "car", "truck", "van", "bus", "motorcycle", "bicycle"),
}
"""Words that stand for several labels; of these an encoder may know some."""

BLUR_WORDS = tuple(BLUR_GROUPS)

MOST_WORDS = 20
"""Words that a map blurs at most."""
