"""Labels of drawn scenes."""

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
"""Label i is the value i in the labels that `Scene.render` returns."""

DYNAMIC = ("bus", "car", "person")
"""Dynamic labels: passing things, which do not belong to a place."""


def label(name: str) -> int:
    """Index of a label in `LABELS`; raises ValueError for an unknown one."""
    return LABELS.index(name)
