"""Golden values against those of today."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Tolerance:
    """How near to a golden value is near enough.

    Parameters
    ----------
    floats : float
        Relative and absolute.
    counts : int
        Of what is counted or rounded, which one flipped comparison changes; one in a hundred is allowed too.
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
"""To the last bit: before and after a change that is to change nothing, on one machine."""

CLOSE = Tolerance(1e-5)
"""Between machines that describe pictures alike; what is then added up may be added in another order."""

ROUNDED = Tolerance(1e-4)
"""Of descriptions by another machine, some bytes of which are rounded to the one beside."""

SIMILAR = Tolerance(1e-2, counts=2, flips=True)
"""Between machines that describe pictures alike but for rounding: here and there a byte of a cell differs by one, and
the best counterpart of a cell or keypoint is another one."""

COUNTED = ("nodes", "correspondences", "edges_agreeing", "inliers", ".matches", "shift", "sampled_descriptors")
"""Parts of the names of what is counted or rounded."""


def differences(expected: Any, actual: Any, tolerance: Tolerance, where: str = "") -> Iterator[str]:
    """Say where two values differ.

    Parameters
    ----------
    expected, actual : what JSON can hold
    tolerance : Tolerance
    where : str
        What the values are called.
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
