"""Connected regions by OpenCV, for the pure core."""

import cv2
import numpy as np

from schemas.description import Booleans
from worker.method.context_graph import Regions


def components(mask: Booleans) -> Regions:
    """8-connected components; see `context_graph.Components`."""
    numbered: Regions = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1]
    return numbered
