"""The words that a drawn scene's labels stand for."""

LABELS = (
    "sky",
    "building",
    "road",
    "sidewalk",
    "grass",
    "path",
    "tree",
    "pole",
    "sign",
    "fence",
    "bench",
    "water",
    "wall",
    "floor",
    "ceiling",
    "door",
    "window",
    "lamp",
    "bus",
    "car",
    "person",
)
"""Word i is the meaning of label i in what `Scene.render` returns."""

DYNAMIC = ("bus", "car", "person")
"""Words for what may stand in front of a place and does not belong to it."""


def label(word: str) -> int:
    """Index of a word; raises ValueError for a word that no scene uses."""
    return LABELS.index(word)
