"""Is a result more than luck? And if not, what is probably wrong.

A figure can look like an achievement and be what a random order gets: the ground truth may be generous, its
files in another order, or its axes the wrong two. This module says so instead of printing the figure alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lab.metrics.recall import DEPTHS, Indices, Truth
from schemas.description import Booleans, Doubles

SIGNIFICANCE = 0.01
"""A result is called more than luck only when luck does as well less often than this."""

FEW_ANSWERS = 0.5
"""Share of queries with the same first answer above which the answers hardly depend on the query."""

GENEROUS = 0.25
"""Chance of recall@1 above which the ground truth itself is suspect."""

FLAT = 0.1
"""An axis whose range is below this share of the other's is probably height."""


TOO_FEW = (
    "the answerable queries, {} in all, cannot tell, whatever the method: there are too few of them, or they show too "
    "few places, so that right answers to all of them could be exchanged as well"
)


@dataclass(frozen=True)
class Luck:
    """The verdict on a ranking.

    Parameters
    ----------
    at_chance : bool
        True when nothing shows that the answers depend on the queries.
    p_value : float
        Share of permuted rankings (see `looks_like_chance`) that did at least as well.
    causes : tuple of str
        What is probably wrong, most telling first; empty unless `at_chance`.
    """

    at_chance: bool
    p_value: float
    causes: tuple[str, ...]


def looks_like_chance(
    ranked: Indices,
    truth: Truth,
    generator: np.random.Generator,
    *,
    depths: Sequence[int] = DEPTHS,
    permutations: int = 999,
) -> Luck:
    """Whether queries would have fared as well with each other's answers.

    Parameters
    ----------
    ranked : int64 of shape (queries, depth)
        Database indices, best first; -1 where there was no further answer.
    truth : Truth
    generator : numpy.random.Generator
    depths : sequence of int
    permutations : int

    Returns
    -------
    Luck

    Notes
    -----
    A permutation test. Rankings are permuted among the answerable queries, which leaves everything about the
    retriever as it is (how often each database image is returned, how answers cluster on the map) except what
    it knew of the query. A random retriever and one that always gives the same answers are both found out:
    permuting changes nothing. Comparing with a uniformly random order would let the second one pass where its
    fixed answers happen to be right for many.

    In online loop closure a permuted ranking may name images that its new query could not have seen; they
    count as wrong, as do images that are ignored for the new query. That makes luck look a little worse than it is,
    and only there.
    """
    answerable = np.flatnonzero(truth.answerable)
    if len(answerable) == 0:
        return Luck(True, 1.0, ("no query has a right answer in the database: check the ground truth and its radius",))
    right = _right_matrix(truth, answerable)
    answers = ranked[answerable]
    got = _score(answers, right, depths)
    p_value = _exchanged(answers, right, generator, depths, permutations)
    if p_value <= SIGNIFICANCE:
        return Luck(False, p_value, ())
    best = np.array([[truth.positives[query][truth.counts[query] // 2]] for query in answerable])
    if _exchanged(best, right, generator, depths, permutations) > SIGNIFICANCE:
        return Luck(True, p_value, (TOO_FEW.format(len(answerable)),))
    return Luck(True, p_value, tuple(_causes(answers, right, truth, answerable, got, depths)))


def suspicions(truth: Truth, positions: Doubles | None = None) -> tuple[str, ...]:
    """What is odd about a ground truth, before any image was looked at.

    Parameters
    ----------
    truth : Truth
    positions : float64 of shape (images, 2) or None
        Where the images were taken, metres.
    """
    found = []
    share = float(truth.answerable.mean()) if len(truth) else 0.0
    if share == 0:
        found.append("no query has a right answer in the database")
    else:
        lucky = np.mean(truth.counts[truth.answerable] / truth.judged[truth.answerable])
        if lucky > GENEROUS:
            found.append(
                f"{lucky:.0%} of the database is right for an average query: a random order does well here, "
                "so a high figure means little (too large a radius, or a database without distractors)"
            )
    if positions is not None and len(positions) > 1:
        ranges = np.ptp(positions, axis=0)
        if ranges.min() < FLAT * ranges.max():
            found.append(
                f"positions span {ranges[0]:.0f} m by {ranges[1]:.0f} m: the smaller axis may be height "
                "(KITTI's ground plane is x and z, columns 3 and 11; column 7 is height)"
            )
    return tuple(found)


def _exchanged(
    answers: Indices, right: Booleans, generator: np.random.Generator, depths: Sequence[int], permutations: int
) -> float:
    """How often answers do at least as well when queries exchange them, the given order counted as one of them."""
    got = _score(answers, right, depths)
    orders = (generator.permutation(len(answers)) for _ in range(permutations))
    as_good = sum(_score(answers[order], right, depths) >= got - 1e-12 for order in orders)
    return (1 + as_good) / (1 + permutations)


def _right_matrix(truth: Truth, answerable: Indices) -> Booleans:
    """Which database image is right for which answerable query; a last column of False catches -1."""
    right = np.zeros((len(answerable), int(truth.searched.max()) + 1), np.bool_)
    for row, query in enumerate(answerable):
        right[row, truth.positives[query]] = True
    return right


def _score(answers: Indices, right: Booleans, depths: Sequence[int]) -> float:
    """Mean of recall@N over the depths: one number, so that one test serves all of them."""
    rows = np.arange(len(right))[:, None]
    ever = np.logical_or.accumulate(right[rows, answers], axis=1)
    last = ever.shape[1] - 1
    return float(np.mean([ever[:, min(depth - 1, last)].mean() for depth in depths]))


def _causes(
    answers: Indices, right: Booleans, truth: Truth, answerable: Indices, got: float, depths: Sequence[int]
) -> list[str]:
    """Likely causes: those with evidence in the answers first, then what to look at anyway."""
    causes = []
    names, times = np.unique(answers[:, 0], return_counts=True)
    if len(answerable) > 1 and times.max() > FEW_ANSWERS * len(answerable):
        causes.append(
            f"{times.max()} of {len(answerable)} queries get the same first answer (database image "
            f"{int(names[times.argmax()])}): the descriptor does not depend on the image"
        )
    order = _order_that_fits(answers, right, got, depths)
    if order:
        causes.append(order)
    causes += suspicions(truth)
    if not causes:
        causes = [
            "file order: the ground truth may count the files in another order (img10 before img2), "
            "or from another offset",
            "ground truth: it may belong to other images, or use the wrong axes (height instead of depth)",
            "the method: its descriptors of two images may not be comparable (a vocabulary per image)",
        ]
    return causes


def _order_that_fits(answers: Indices, right: Booleans, got: float, depths: Sequence[int]) -> str:
    """Whether the answers fit the truth of the queries a fixed offset away, or of those in reverse order."""
    n = len(right)
    # A neighbour of the right place is often right too, so small offsets prove nothing; with few queries, luck
    # over many offsets does.
    if n < 20:
        return ""
    reverse = _score(answers[::-1], right, depths)
    offsets = range(1, n, max(1, n // 512))
    scores = [(_score(np.roll(answers, offset, axis=0), right, depths), offset) for offset in offsets]
    best, offset = max(scores)
    needed = max(3 * got, got + 0.2)
    if reverse >= max(best, needed):
        return f"the answers fit the ground truth read in reverse order (mean recall {reverse:.2f} against {got:.2f})"
    if best >= needed:
        shown = offset if offset <= n // 2 else offset - n
        return (
            f"the answers fit the ground truth of the query {abs(shown)} places "
            f"{'further on' if shown > 0 else 'before'} (mean recall {best:.2f} against {got:.2f}): "
            "images and ground truth are offset"
        )
    return ""
