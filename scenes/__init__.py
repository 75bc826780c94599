"""Drawn places, for the demo and the tests: photos of others cannot be shipped, and drawn ones have exact labels.

scene("square").at("dusk").behind("bus").seen_from(dx=1.0, turn=5).pixels
"""

from scenes.geometry import Viewpoint
from scenes.scene import Scene, scene
from scenes.words import DYNAMIC, LABELS

__all__ = ["DYNAMIC", "LABELS", "Scene", "Viewpoint", "scene"]
