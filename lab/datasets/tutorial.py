"""The protocol of "Visual Place Recognition: A Tutorial" (Schubert et al. 2023), for aligned walks.

Right is the frame of the same number and no other. Frames up to eight before or after it are neither right nor wrong:
they are left out of the answers. The tutorial's own example is Gardens Point, ``day_right`` enrolled, ``night_right``
queried.
"""

from dataclasses import replace

import numpy as np

from lab.datasets.dataset import Dataset
from schemas.errors import InvalidParameters

NEAR = 8
"""Frames on either side that are neither right nor wrong."""


def diagonal(dataset: Dataset, near: int = NEAR) -> Dataset:
    """The same images, judged frame for frame.

    Parameters
    ----------
    dataset : Dataset
        Two walks of equally many images, the number i of which show one place.
    near : int

    Raises
    ------
    InvalidParameters
        The walks differ in length.
    """
    count = len(dataset.database)
    if len(dataset.queries) != count:
        raise InvalidParameters.of(
            "protocol",
            f"vpr-tutorial needs as many queries as database images; {dataset.name} has {len(dataset.queries)} and "
            f"{count}. Point --root at a set of two aligned walks, as gardenspoint",
        )
    frames = np.arange(count, dtype=np.int64)
    around = [frames[max(0, i - near) : i + near + 1] for i in range(count)]
    return replace(
        dataset,
        name=f"{dataset.name} (vpr-tutorial)",
        positives=tuple(frames[i : i + 1] for i in range(count)),
        ignored=tuple(some[some != i] for i, some in enumerate(around)),
        truth=f"the frame of the same number; {near} before and after it are ignored",
    )
