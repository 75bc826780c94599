"""Calibration on a map of one's own: the shipped curve, adjusted by labelled queries and judged on held-out ones.

A few labels move the curve and its thresholds little, many decide: the shipped curve is the prior of the fit, and the
shipped thresholds count like answers seen before. Whether that helps is judged by queries that the curve was not fitted
to, in whole blocks, since neighbours along a path resemble each other.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from schemas.description import Booleans, Doubles, Indices
from worker.method.calibration import Calibration, Logistic

FEWEST = 20
"""Labelled queries needed at least."""

FOLDS = 5
"""Parts into which blocks of queries are dealt; each is judged by a curve that was fitted to the others."""

BLOCKS = 20
"""Blocks that queries without blocks of their own are cut into, if each has `SHORTEST` queries then."""

SHORTEST = 3
"""Consecutive queries in a block."""

STIFFNESS = 4.0
"""Ridge of the weights towards the shipped ones. Features are standardised as in the shipped curve, so that this is
half a standard deviation between maps."""

BIAS_STIFFNESS = 1.0
"""Ridge of the bias towards the shipped one: between maps it differs more than the weights."""

SEEN_BEFORE = 50.0
"""Matched answers that the shipped thresholds count for."""

HIGHEST = 0.9975
"""Highest threshold that is tried."""

NEVER = 1.0
"""Threshold for a precision that no threshold keeps."""

Z95 = 1.959964
"""Of a two-sided 95 % interval."""


@dataclass(frozen=True, eq=False)
class Labelled:
    """Labelled queries of a map: what the curve reads of their first places, and whether these were right.

    Parameters
    ----------
    features : float64 of shape (n, features)
        In the order of the shipped calibration.
    right : bool of shape (n,)
    known : bool of shape (n,)
        Whether the map has the place at all. An answer to a query whose place it lacks cannot be right.
    blocks : intp of shape (n,)
        Queries with one number are judged together.
    """

    features: Doubles
    right: Booleans
    known: Booleans
    blocks: Indices

    def __post_init__(self) -> None:
        lengths = {len(self.features), len(self.right), len(self.known), len(self.blocks)}
        if len(lengths) != 1 or not np.isfinite(self.features).all():
            raise ValueError(f"labelled queries need finite features and as many labels, not {lengths} of each")

    def missing(self) -> list[str]:
        """What is needed before anything can be fitted and judged, in words; empty when nothing is."""
        n, right = len(self.right), int(self.right.sum())
        lacks = []
        if n < FEWEST:
            lacks.append(f"{n} labelled queries with an answer; at least {FEWEST} are needed, hundreds are better")
        if n and right in (0, n):
            lacks.append(f"all answers are {'right' if right else 'wrong'}; both kinds are needed")
        if n and len(np.unique(self.blocks)) < 2:
            lacks.append("all queries are of one block; at least two are needed, one to fit and one to judge")
        return lacks


@dataclass(frozen=True)
class Share:
    """A share of some answers, with its 95 % interval (Wilson); `value` is None when there is none of them.

    Parameters
    ----------
    count, of : int
    """

    count: int
    of: int

    @property
    def value(self) -> float | None:
        """0..1."""
        return self.count / self.of if self.of else None

    @property
    def interval(self) -> tuple[float, float]:
        """Lowest and highest share that go with the count; 0 and 1 for nothing counted.

        Notes
        -----
        Wilson (1927), score interval. It takes answers as independent; neighbours along a path are not quite.
        """
        if not self.of:
            return 0.0, 1.0
        share, n = self.count / self.of, self.of
        middle = (share + Z95**2 / (2 * n)) / (1 + Z95**2 / n)
        half = Z95 / (1 + Z95**2 / n) * float(np.sqrt(share * (1 - share) / n + Z95**2 / (4 * n * n)))
        return max(0.0, middle - half), min(1.0, middle + half)


@dataclass(frozen=True)
class HeldOut:
    """How a calibration did on queries that it was not fitted to.

    Parameters
    ----------
    log_loss : float
        Mean negative natural logarithm of the probability of what came true.
    expected_error : float
        Expected calibration error, ten bins.
    precision : Share
        Right ones among the matched answers.
    matched_share : Share
        Matched ones among the right answers.
    false_accepts : Share
        Matched ones among the answers to queries whose place the map lacks.
    """

    log_loss: float
    expected_error: float
    precision: Share
    matched_share: Share
    false_accepts: Share


@dataclass(frozen=True, eq=False)
class OwnCalibration:
    """A map's own calibration and what its held-out queries promise, as it is kept with the map.

    Parameters
    ----------
    calibration : Calibration
        Fitted to all queries; its `shares` are held-out ones.
    achieved : float64 of shape (precisions,)
        Held-out precision at each of the calibration's precisions; NaN where nothing was matched.
    queries : int
    made_at : str
        RFC 3339.
    """

    calibration: Calibration
    achieved: Doubles
    queries: int
    made_at: str = ""

    def precision(self, wanted: float) -> float | None:
        """Held-out precision where this one is wanted; None when nothing was matched."""
        found = float(np.interp(wanted, self.calibration.precisions, self.achieved))
        return None if np.isnan(found) else found

    def to_json(self) -> str:
        """Text that `from_json` reads back."""
        achieved = [None if np.isnan(one) else float(one) for one in self.achieved]
        data = {"calibration": self.calibration.to_json(), "achieved": achieved}
        return json.dumps({**data, "queries": self.queries, "made_at": self.made_at}, sort_keys=True, allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> "OwnCalibration":
        """Read what `to_json` wrote."""
        data = json.loads(text)
        achieved = np.array([np.nan if one is None else one for one in data["achieved"]], np.float64)
        return cls(Calibration.from_json(data["calibration"]), achieved, int(data["queries"]), data["made_at"])


@dataclass(frozen=True, eq=False)
class Fitted:
    """What came of labelled queries.

    Parameters
    ----------
    own : OwnCalibration
    shipped_does, own_does : HeldOut
        The shipped and the own calibration on the same queries.
    blocks, folds : int
    """

    own: OwnCalibration
    shipped_does: HeldOut
    own_does: HeldOut
    blocks: int
    folds: int

    @property
    def transfers(self) -> bool:
        """Whether what was fitted to some of the queries helps with the others: the log loss is not worse."""
        return self.own_does.log_loss <= self.shipped_does.log_loss


def consecutive_blocks(count: int) -> Indices:
    """Block of each of so many consecutive queries, intp (count,): runs of equal length, at most about `BLOCKS`."""
    return np.arange(count) // max(SHORTEST, -(-count // BLOCKS))


def calibrate(labelled: Labelled, shipped: Calibration, precision: float) -> Fitted:
    """Adjust a shipped calibration to a map's labelled queries, and judge both.

    Parameters
    ----------
    labelled : Labelled
    shipped : Calibration
        With a logistic curve.
    precision : float
        Share of matched answers that must be right, 0.5..0.999: where precision and matched share are judged.

    Raises
    ------
    ValueError
        Something is `Labelled.missing`, or the shipped curve is not logistic.
    """
    if lacks := labelled.missing():
        raise ValueError("; ".join(lacks))
    fold = _folds(labelled.blocks)
    numbers = np.unique(fold)
    probability = np.empty(len(fold))
    curves = {}
    for number in numbers:
        mine = fold == number
        curves[number] = adjust(shipped.curve, labelled.features[~mine], labelled.right[~mine])
        probability[mine] = curves[number].probability(labelled.features[mine])
    # Thresholds, too, are judged by queries that they were not chosen by, nor by curves that were fitted to these.
    limits = np.empty((len(fold), len(shipped.precisions)))
    matched = np.zeros(len(fold), np.bool_)
    for number in numbers:
        mine = fold == number
        apart = np.empty(len(fold))
        for other in numbers[numbers != number]:
            theirs = fold == other
            rest = ~(mine | theirs)
            curve = adjust(shipped.curve, labelled.features[rest], labelled.right[rest])
            apart[theirs] = curve.probability(labelled.features[theirs])
        chosen = choose_thresholds(apart[~mine], labelled.right[~mine], shipped)
        limits[mine] = chosen
        kept = replace(shipped, curve=curves[number], thresholds=chosen)
        matched[mine] = probability[mine] >= kept.threshold(precision)
    accepted = probability[:, None] >= limits
    with np.errstate(invalid="ignore"):
        achieved = (accepted & labelled.right[:, None]).sum(axis=0) / accepted.sum(axis=0)
    calibration = replace(
        shipped,
        curve=adjust(shipped.curve, labelled.features, labelled.right),
        thresholds=choose_thresholds(probability, labelled.right, shipped),
        shares=accepted[labelled.right].mean(axis=0),
        learned_from=f"{shipped.learned_from}; {len(fold)} labelled queries of the map",
    )
    before = np.asarray(shipped.curve.probability(labelled.features), np.float64)
    return Fitted(
        own=OwnCalibration(calibration, achieved, len(fold)),
        shipped_does=_judge(before, before >= shipped.threshold(precision), labelled),
        own_does=_judge(probability, matched, labelled),
        blocks=len(np.unique(labelled.blocks)),
        folds=len(numbers),
    )


def adjust(shipped: object, features: Doubles, right: Booleans) -> Logistic:
    """The logistic curve of least log loss with a ridge towards a shipped one, and no negative weight.

    Parameters
    ----------
    shipped : Logistic
    features : float64 of shape (n, features)
    right : bool of shape (n,)

    Raises
    ------
    ValueError
        The shipped curve is not logistic.

    Notes
    -----
    Minimises ``sum(log(1 + exp(z)) - right z) + 0.5 sum(ridge (w - prior)^2)`` with ``z = x w`` by Newton steps on the
    weights that are not held at 0, halved until the loss falls. The ridge makes the minimum unique.
    """
    if not isinstance(shipped, Logistic):
        raise ValueError("only a logistic curve can be adjusted")
    x = np.column_stack([(features - shipped.mean) / shipped.scale, np.ones(len(features))])
    prior = np.append(shipped.weights, shipped.bias)
    ridge = np.append(np.full(len(shipped.weights), STIFFNESS), BIAS_STIFFNESS)
    lowest = np.append(np.zeros(len(shipped.weights)), -np.inf)

    def loss(w: Doubles) -> float:
        z = x @ w
        return float(np.sum(np.logaddexp(0, z) - right * z) + 0.5 * np.sum(ridge * (w - prior) ** 2))

    w = prior
    for _ in range(100):
        p = 0.5 * (1 + np.tanh(x @ w / 2))
        slope = x.T @ (p - right) + ridge * (w - prior)
        free = (w > lowest) | (slope < 0)
        if np.abs(slope[free]).max(initial=0.0) < 1e-9:
            break
        curvature = (x * (p * (1 - p))[:, None]).T @ x + np.diag(ridge)
        step = np.zeros_like(w)
        step[free] = np.linalg.solve(curvature[np.ix_(free, free)], slope[free])
        now, size = loss(w), 1.0
        while size > 1e-10 and loss(np.maximum(w - size * step, lowest)) >= now:
            size /= 2
        if size <= 1e-10:
            break  # as low as the arithmetic tells
        w = np.maximum(w - size * step, lowest)
    return Logistic(shipped.mean, shipped.scale, w[:-1], float(w[-1]))


def choose_thresholds(probability: Doubles, right: Booleans, shipped: Calibration) -> Doubles:
    """For each of the shipped precisions the lowest threshold whose matched answers keep it.

    Parameters
    ----------
    probability : float64 of shape (n,)
        By curves that were not fitted to these queries.
    right : bool of shape (n,)
    shipped : Calibration
        Its thresholds count as `SEEN_BEFORE` matched answers of the precision that they promise: a few answers, all
        right by chance, do not lower a threshold much.

    Returns
    -------
    float64 of shape (precisions,)
        Ascending; `NEVER` where none keeps the precision.
    """
    tried = np.arange(shipped.ambiguous, HIGHEST + 1e-9, 0.0025)
    matched = probability >= tried[:, None]
    counted, good = matched.sum(axis=1), (matched & right).sum(axis=1)
    share = (good + SEEN_BEFORE * _promised(tried, shipped)) / (counted + SEEN_BEFORE)
    lowest = [tried[share >= wanted - 1e-9][:1] for wanted in shipped.precisions]
    return np.maximum.accumulate([float(one[0]) if len(one) else NEVER for one in lowest])


def _promised(threshold: Doubles, shipped: Calibration) -> Doubles:
    """Precision that the shipped thresholds promise at some thresholds, float64: `Calibration.threshold` inverted."""
    # Where several precisions share a threshold, it promises the highest of them.
    distinct, last = np.unique(shipped.thresholds[::-1], return_index=True)
    precisions = shipped.precisions[::-1][last]
    inside = np.interp(threshold, distinct, precisions)
    beyond = 1 - (1 - threshold) * (1 - precisions[-1]) / max(1 - float(distinct[-1]), 1e-9)
    return np.where(threshold > distinct[-1], beyond, inside)


def _folds(blocks: Indices) -> Indices:
    """Fold of each query, intp (n,): blocks, the largest first, go to the fold with fewest queries."""
    _, first, of, sizes = np.unique(blocks, return_index=True, return_inverse=True, return_counts=True)
    filled = np.zeros(min(FOLDS, len(sizes)), np.intp)
    fold_of = np.empty(len(sizes), np.intp)
    for block in np.lexsort((first, -sizes)):
        fold_of[block] = np.argmin(filled)
        filled[fold_of[block]] += sizes[block]
    return fold_of[of]


def _judge(probability: Doubles, matched: Booleans, labelled: Labelled) -> HeldOut:
    right, unknown = labelled.right, ~labelled.known
    safe = np.clip(probability, 1e-12, 1 - 1e-12)
    return HeldOut(
        log_loss=float(-np.mean(np.where(right, np.log(safe), np.log1p(-safe)))),
        expected_error=_expected_error(probability, right),
        precision=_share(matched & right, matched),
        matched_share=_share(matched & right, right),
        false_accepts=_share(matched & unknown, unknown),
    )


def _share(these: Sequence[bool] | Booleans, of: Sequence[bool] | Booleans) -> Share:
    return Share(int(np.sum(these)), int(np.sum(of)))


def _expected_error(probability: Doubles, right: Booleans, bins: int = 10) -> float:
    """Mean of |promised - true| over equally wide bins of probability, weighted by their queries."""
    where = np.minimum((probability * bins).astype(np.int64), bins - 1)
    gaps = np.bincount(where, weights=probability - right, minlength=bins)
    return float(np.abs(gaps).sum() / len(right))
