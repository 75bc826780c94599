"""Compares golden values with those of today."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Tolerance:
    """The allowed differences from golden values.

    Parameters
    ----------
    floats : float
        Relative and absolute difference of floats.
    counts : int
        Difference of counts and rounded numbers, which one flipped comparison changes; 1 % is always allowed with it.
    flips : bool
        Whether nothing is said of which pairs of the best match are its first.
    digests : bool
        Whether digests must agree.
    """

    floats: float
    counts: int = 0
    flips: bool = False
    digests: bool = False


EXACT = Tolerance(0.0, digests=True)
"""Equal to the last bit: on one machine, before and after a change that must not change results."""

CLOSE = Tolerance(1e-5)
"""Between machines that describe images alike: sums may be taken in another order."""

ROUNDED = Tolerance(1e-4)
"""Of descriptions by another machine, some bytes of which are rounded to a neighbouring value."""

SIMILAR = Tolerance(1e-2, counts=2, flips=True)
"""Between machines that describe images alike but for rounding: some bytes of cells differ by one, so that some cells
and keypoints have another best counterpart."""

COUNTED = ("nodes", "correspondences", "edges_agreeing", "inliers", ".matches", "shift", "sampled_descriptors")
"""Parts of the names of counts and rounded numbers."""


def differences(expected: Any, actual: Any, tolerance: Tolerance, where: str = "") -> Iterator[str]:
    """Describe each difference between two values.

    Parameters
    ----------
    expected, actual : what JSON can hold
    tolerance : Tolerance
    where : str
        Name of the values, as a path.
    """
    if where.endswith("sha256") and not tolerance.digests:
        return
    if ".pairs of" in where and tolerance.flips:
        return
    if isinstance(expected, dict) and isinstance(actual, dict):
        for key in sorted(expected.keys() | actual.keys()):
            inner = f"{where}/{key}"
            if key not in actual or key not in expected:
                yield f"{inner}: {'is missing' if key not in actual else 'is new'}"
            else:
                yield from differences(expected[key], actual[key], tolerance, inner)
    elif isinstance(expected, list) and isinstance(actual, list) and len(expected) == len(actual):
        for number, (one, other) in enumerate(zip(expected, actual, strict=True)):
            yield from differences(one, other, tolerance, f"{where}/{number}")
    elif type(expected) is not type(actual) or not _near(expected, actual, tolerance, where):
        yield f"{where}: {actual!r} instead of {expected!r}"


def _near(expected: Any, actual: Any, tolerance: Tolerance, where: str) -> bool:
    if isinstance(expected, float):
        return math.isclose(expected, float(actual), rel_tol=tolerance.floats, abs_tol=tolerance.floats)
    if tolerance.counts and isinstance(expected, int) and any(name in where for name in COUNTED):
        return abs(expected - int(actual)) <= max(tolerance.counts, abs(expected) // 100)
    return bool(expected == actual)
