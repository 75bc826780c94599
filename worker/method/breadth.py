"""Breadth of a lead: over how much of an image one view agrees with it better than another.

A right view leads a little in most of the image, also at night, when all agreement is weak. A look-alike leads much in
a few spots and loses in others. The sum of the differences cannot tell these apart; compared with their scatter it can.
"""

import numpy as np

from schemas.description import Floats


def breadth(first: Floats, other: Floats | None) -> float:
    """The lead of one view over another, in units of its own scatter from cell to cell.

    Parameters
    ----------
    first, other : float32 of shape (cells,)
        Weight that agrees at each cell of the query, at least 0; None agrees nowhere.

    Returns
    -------
    float
        0 without a lead, at most the root of the number of cells.

    Notes
    -----
    Sum of d over the root of the sum of d squared, where d is the difference at each cell: Student's paired t but for
    the mean, which is not taken out of the scatter, so that equal differences everywhere give the largest value and not
    infinity. Cells are not independent, so this is no test: it is compared with what wrong answers get in the map.
    """
    difference = first.astype(np.float64) - (0.0 if other is None else other)
    scatter = float(np.sqrt(np.square(difference).sum()))
    return max(float(difference.sum()) / scatter, 0.0) if scatter > 0 else 0.0
