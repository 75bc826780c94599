"""Geometric verification: do matched keypoints lie in the same arrangement?

Matches are mutually nearest descriptors that pass the ratio test. Each two of the strongest matches propose a
similarity transform; the proposal with most inliers is refined to an affine transform, whose inliers count. All
proposals are computed at once, and none is drawn at random.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from schemas.description import Booleans, Doubles, Floats, Indices, Int8s, LocalFeatures
from schemas.errors import DescriptorMismatch

RATIO = 0.8
"""Largest ratio of the Euclidean distances, at unit length, to the best and the second-best descriptor (Lowe 2004)."""

TOLERANCE = 8 / 480
"""Largest distance of an inlier from its transformed position, as a fraction of the longer side."""

LEAST = 5
"""Fewer matches or inliers than this are no evidence."""

PROPOSERS = 32
"""How many of the strongest matches propose transforms, two at a time: 496 proposals at most."""

LARGEST_ZOOM = 3.0
"""Largest plausible zoom between two images; a stronger one comes from wrong matches."""

LARGEST_TURN = np.radians(35)
"""Largest plausible rotation, radians: cameras are held upright."""

SLIM = 1e-10
"""Determinant of the scatter matrix over its squared trace; up to this, points lie on a line and fix no affine
transform."""

SHORTEST = 1e-9
"""A descriptor shorter than this counts as zero; its cosine with any other is 0."""

UNREMARKABLE = 8
"""By how many inliers a candidate must exceed the median of the verified ones before they count."""

SOFTENING = 20
"""Inliers added to that median, so that a few inliers over a median of 0 stay weak evidence."""


@dataclass(frozen=True, eq=False)
class Verified:
    """Result of the geometric verification of one view.

    Parameters
    ----------
    inliers : int
        Matches that follow the transform; 0 without one.
    matches : int
        Before geometric verification.
    transform : float32 of shape (2, 3), or None
        Maps the query's positions (x, y, 1) to the view's, in fractions of the longer side.
    pairs : float32 of shape (inliers, 4)
        (x, y) in the query and (x, y) in the view of each inlier.
    """

    inliers: int
    matches: int
    transform: Floats | None
    pairs: Floats


def match(query: Int8s | Floats, views: Sequence[Int8s | Floats]) -> list[Indices]:
    """Mutually nearest descriptors that pass the ratio test (`RATIO`), for each view.

    Parameters
    ----------
    query : int8 or float32 of shape (n, channels)
        Of nearly equal length, none zero.
    views : sequence of int8 or float32 of shape (m, channels)

    Returns
    -------
    list of intp of shape (matches, 2)
        Rows of `query` and of the view, the strongest first; ties by the query's row.

    Raises
    ------
    DescriptorMismatch
        Query and a view have different channels.
    """
    for view in views:
        if query.shape[1] != view.shape[1]:
            raise DescriptorMismatch(got=query.shape[1], want=view.shape[1])
    ends = np.cumsum([len(view) for view in views]).tolist()
    if len(query) == 0 or not ends or ends[-1] == 0:
        return [np.zeros((0, 2), np.intp) for _ in views]
    # One matrix product for all views. Products of bytes are whole numbers, which float32 sums exactly, so that no
    # view's matches depend on the other views; the division by lengths comes afterwards.
    ours, theirs = query.astype(np.float32), np.concatenate(views).astype(np.float32)
    cosines = ours @ theirs.T
    cosines *= 1 / np.maximum(np.linalg.norm(ours, axis=1, keepdims=True), SHORTEST)
    cosines *= 1 / np.maximum(np.linalg.norm(theirs, axis=1), SHORTEST)
    highest = cosines.max(axis=0)
    return [
        _mutual(cosines[:, end - len(view) : end], highest[end - len(view) : end])
        for view, end in zip(views, ends, strict=True)
    ]


def consensus(source: Floats, target: Floats) -> tuple[Doubles | None, Booleans]:
    """The transform that most of the matched positions follow.

    Parameters
    ----------
    source, target : float32 of shape (matches, 2)
        Positions of matched keypoints, the strongest match first, in fractions of the longer side.

    Returns
    -------
    transform : float64 of shape (2, 3), or None
        Affine; None when no plausible proposal has `LEAST` inliers.
    inliers : bool of shape (matches,)
        Which matches follow it.
    """
    nobody = np.zeros(len(source), np.bool_)
    if len(source) < LEAST:
        return None, nobody
    followers = _best_similarity(source, target)
    # Columns x, y, 1 of the source and x, y of the target.
    matched = np.ones((len(source), 5))
    matched[:, :2], matched[:, 3:] = source, target
    for _ in range(3):
        if np.count_nonzero(followers) < LEAST:
            return None, nobody
        transform = _affine(matched[followers])
        followers = _follow(transform, matched) < TOLERANCE
    if np.count_nonzero(followers) < LEAST or not _plausible(transform):
        return None, nobody
    return transform, followers


def verify(query: LocalFeatures, views: Sequence[LocalFeatures]) -> list[Verified]:
    """Match the keypoints of a query with those of each view, and count the inliers.

    Raises
    ------
    DescriptorMismatch
        Descriptors of the query and of a view differ in channels.
    """
    found = []
    matched = match(query.descriptors, [view.descriptors for view in views])
    for view, pairs in zip(views, matched, strict=True):
        source, target = query.positions[pairs[:, 0]], view.positions[pairs[:, 1]]
        transform, inliers = consensus(source, target)
        found.append(
            Verified(
                inliers=int(inliers.sum()),
                matches=len(pairs),
                transform=None if transform is None else transform.astype(np.float32),
                pairs=np.concatenate([source[inliers], target[inliers]], axis=1).astype(np.float32),
            )
        )
    return found


def gated_bonus(inliers: npt.ArrayLike, among: npt.ArrayLike | None = None) -> Floats:
    """Bonus for inliers beyond the median of the verified candidates.

    Parameters
    ----------
    inliers : array-like of int, shape (candidates,)
        Inliers of the candidates verified for one query.
    among : array-like of int, shape (some,), optional
        Those that the median is of, without further views of the first place; otherwise `inliers`.

    Returns
    -------
    float32 of shape (candidates,)
        max(0, n - m - 8) / (n + 12) for n inliers and the median m: 0..1, and never falls as n grows. Where
        keypoints do not match (night, snow) all candidates are near the median, get 0, and other evidence decides.
    """
    counts = np.asarray(inliers, np.float32)
    if counts.size == 0:
        return np.zeros(0, np.float32)
    usual = float(np.median(counts if among is None else np.asarray(among, np.float32)))
    excess = np.maximum(counts - usual - UNREMARKABLE, 0)
    bonus: Floats = (excess / (excess + usual + SOFTENING)).astype(np.float32)
    return bonus


def _mutual(cosines: Floats, highest: Floats) -> Indices:
    """Matches with one view, intp (matches, 2), from cosines (n, m), overwritten, and their column maxima (m,)."""
    if cosines.shape[1] == 0:
        return np.zeros((0, 2), np.intp)
    rows = np.arange(len(cosines))
    best = cosines.argmax(axis=1)
    strength = cosines[rows, best]
    cosines[rows, best] = -1
    second = cosines.max(axis=1)
    # |a - b|^2 = 2 - 2 cos for unit vectors.
    kept = np.flatnonzero((strength == highest[best]) & (1 - strength < RATIO**2 * (1 - second)))
    # Among equal rows with one best counterpart the first keeps it.
    kept = kept[np.unique(best[kept], return_index=True)[1]]
    kept = kept[np.lexsort((kept, -strength[kept]))]
    return np.stack([kept, best[kept]], axis=1)


@lru_cache(maxsize=PROPOSERS + 1)
def _couples(count: int) -> tuple[Indices, Indices]:
    """All pairs of different numbers below `count`, the smaller first."""
    first, second = np.triu_indices(count, k=1)
    return first, second


def _best_similarity(source: Floats, target: Floats) -> Booleans:
    """Inliers of the proposed similarity with most inliers, bool (matches,); ties go to the first proposed."""
    # As complex numbers a similarity is w = a z + b, and two points fix it.
    z = source[:, 0].astype(np.complex64) + 1j * source[:, 1]
    w = target[:, 0].astype(np.complex64) + 1j * target[:, 1]
    first, second = _couples(min(len(z), PROPOSERS))
    apart = z[second] - z[first]
    far = np.abs(apart) > 2 * TOLERANCE
    first, second, apart = first[far], second[far], apart[far]
    a = (w[second] - w[first]) / apart
    upright = (np.abs(np.angle(a)) < LARGEST_TURN) & (np.abs(np.log(np.abs(a) + 1e-9)) < np.log(LARGEST_ZOOM))
    a, first = a[upright], first[upright]
    if len(a) == 0:
        return np.zeros(len(z), np.bool_)
    b = w[first] - a * z[first]
    # Real and imaginary part of a z + b - w, for all proposals and matches, as matrix products.
    one, minus = np.ones(len(z), np.float32), np.full(len(a), -1, np.float32)
    across = np.stack([a.real, -a.imag, b.real, minus], axis=1) @ np.stack([z.real, z.imag, one, w.real])
    down = np.stack([a.imag, a.real, b.imag, minus], axis=1) @ np.stack([z.real, z.imag, one, w.imag])
    across *= across
    down *= down
    across += down
    follows = across < (1.5 * TOLERANCE) ** 2
    return np.asarray(follows[np.count_nonzero(follows, axis=1).argmax()], np.bool_)


def _affine(matched: Doubles) -> Doubles:
    """Least-squares affine transform, float64 (2, 3); a linear part of zeros for points on one line.

    `matched`, float64 (n, 5): x, y, 1 of the source and x, y of the target.
    """
    (xx, xy, x, xu, xv), (_, yy, y, yu, yv), (_, _, n, u, v), _, _ = (matched.T @ matched).tolist()
    xx, xy, yy = xx - x * x / n, xy - x * y / n, yy - y * y / n
    determinant = xx * yy - xy * xy
    rows = []
    for xt, yt, t in ((xu, yu, u), (xv, yv, v)):
        xt, yt = xt - x * t / n, yt - y * t / n
        p, q = 0.0, 0.0
        if determinant > SLIM * (xx + yy) ** 2:
            p, q = (xt * yy - yt * xy) / determinant, (yt * xx - xt * xy) / determinant
        rows.append([p, q, (t - p * x - q * y) / n])
    return np.array(rows)


def _follow(transform: Doubles, matched: Doubles) -> Doubles:
    """Distance of each target from its transformed source, float64 (matches,); `matched` as in `_affine`."""
    apart = matched[:, :3] @ transform.T - matched[:, 3:]
    distance: Doubles = np.sqrt(np.einsum("ij,ij->i", apart, apart))
    return distance


def _plausible(transform: Doubles) -> bool:
    """Whether an affine transform keeps orientation and neither squeezes nor stretches beyond `LARGEST_ZOOM`."""
    (a, b, _), (c, d, _) = transform.tolist()
    determinant = a * d - b * c
    if determinant <= 0:
        return False
    # Singular values: their product is the determinant, the sum of their squares that of the squared elements.
    squares = a * a + b * b + c * c + d * d
    largest = np.sqrt((squares + np.sqrt(max(squares**2 - 4 * determinant**2, 0))) / 2)
    return bool(largest < LARGEST_ZOOM and determinant / largest > 1 / LARGEST_ZOOM)
