"""Drawn places for the demo, the tests and training: free of others' rights, and with exact labels.

scene("square").at("dusk").behind("bus").seen_from(dx=1.0, turn=5).pixels
building(seed=1, floors=4, spots=6).enrolments()
"""

from scenes.building import Building, building
from scenes.geometry import Viewpoint
from scenes.scene import Scene, scene
from scenes.words import DYNAMIC, LABELS

__all__ = ["DYNAMIC", "LABELS", "Building", "Scene", "Viewpoint", "building", "scene"]
