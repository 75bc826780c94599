"""Decision: from a ranking to probabilities of places, one verdict, and the reason for it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile

import numpy as np

from schemas.comparisons import MapLevels
from worker.method.calibration import Calibration, Verdict
from worker.method.evidence import Ranking
from worker.method.features import expected_levels, features, first_features, floor, tells_apart
from worker.method.reasons import (
    BETTER_PHOTO,
    EMPTY,
    HISTOGRAMS_ALONE,
    LIKE_ELSEWHERE,
    NOTHING_SHOWN,
    OF_NO_PLACE,
    Reason,
    reason_for,
)

GROUPED = 10
"""Views that are grouped into places at least; those further down the ranking never decide."""


@dataclass(frozen=True)
class PlaceProbability:
    """A place and the probability that the query shows it.

    Parameters
    ----------
    probability : float
        0..1; those of all places and of none of them sum to 1.
    views : tuple of int
        Indices of its views in the ranking, best first.
    """

    probability: float
    views: tuple[int, ...]


@dataclass(frozen=True)
class Decision:
    """The verdict on an answer.

    Parameters
    ----------
    status : {"matched", "ambiguous", "no_match"}
    confidence : float
        Probability that the first place is right; 0 without a match.
    reason : Reason
    places : tuple of PlaceProbability
        Best first.
    confidences, weights : tuple of float
        Of the grouped views: the probability of each one's place, never rising with rank; and what its position counts
        for an estimate, where that is not the same.
    precision, threshold : float
        Share of matched answers that must be right, and the probability from which an answer is matched.
    levels : MapLevels
        What wrong answers get in this map, as `expected_levels` gives it.
    features : mapping of name to float
        What the calibration read of the first place; empty without a match.
    """

    status: Verdict
    confidence: float
    reason: Reason
    precision: float
    threshold: float
    levels: MapLevels
    places: tuple[PlaceProbability, ...] = ()
    confidences: tuple[float, ...] = ()
    features: Mapping[str, float] = field(default_factory=dict)
    weights: tuple[float, ...] = ()

    @property
    def nowhere(self) -> float:
        """Probability that the query shows none of the places."""
        return max(0.0, 1.0 - sum(place.probability for place in self.places))


def decide(
    ranking: Ranking,
    levels: MapLevels,
    calibration: Calibration,
    precision: float,
    *,
    searched: int,
    shown: int = GROUPED,
    measured_alike: bool = True,
) -> Decision:
    """Probability of each place, and the verdict on the answer.

    Parameters
    ----------
    ranking : Ranking
    levels : MapLevels
        Of the map.
    calibration : Calibration
    precision : float
        Share of matched answers that must be right, 0.5..0.999.
    searched : int
        Number of views searched.
    shown : int
        Number of views that are grouped into places, if more than `GROUPED`.
    measured_alike : bool
        Whether the views of the map were compared with one another by the same stages as this query. If not, what wrong
        answers get in the map says nothing of it, and no lead counts.

    Notes
    -----
    The probability of a place depends on its best view, the best view of any other place, and the map: more views of
    the place can only raise it. That of the second place is the probability that the first is wrong times what the
    curve says of the second, and so on, so that all of them and "none" sum to 1. Places that the map takes for each
    other, and of which the query shows one for sure, have the probability of that among them (`shared`). Places of
    which no view is among the first `GROUPED` have 0: else that of none, and of the places of other searches, would
    depend on `shown`.
    """
    usual, threshold = expected_levels(levels), calibration.threshold(precision)
    if not len(ranking.seqs):
        return Decision("no_match", 0.0, EMPTY, precision, threshold, usual)
    seqs = [int(seq) for seq in ranking.seqs]
    rival = ranking.rival
    groups = ranking.places.group(seqs[: max(shown, GROUPED)])
    decided = [group for group in groups if group[0] < GROUPED]
    scores = [float(ranking.scores[group[0]]) for group in decided]
    least = floor(ranking.others, usual)
    own_weight = tells_apart(ranking.rival_inliers, ranking.others)
    undisputed = tells_apart(None if ranking.rival_inliers is None else 0, ranking.others)
    lowest = least if measured_alike else 1.0

    def is_sure(of: Mapping[str, float]) -> bool:
        return calibration.probabilities([of])[0] >= threshold

    first = first_features(ranking, ranking.rivals, usual, lowest, own_weight)
    read = [first, *(features(score, scores[0], usual) for score in scores[1:])]
    probabilities = calibration.probabilities(read)
    outrivalled = rival is not None and is_sure(first_features(ranking, (), usual, least, undisputed))
    stand_out_together = False
    if rival is not None and outrivalled and ranking.places.alike(seqs[0], seqs[rival]):
        # Places that the map itself takes for each other: the query may show one of them, without telling which.
        of_any = first_features(ranking, views_unlike(ranking), usual, least, own_weight)
        [together] = calibration.probabilities([of_any])
        stand_out_together = probabilities[0] < threshold <= together
        tied = len([*takewhile(lambda group: ranking.places.alike(seqs[0], seqs[group[0]]), decided)])
        if stand_out_together and tied > 1:
            probabilities[:tied] = shared(probabilities[0], together, tied)
    places = _in_turn(groups, probabilities)
    confidence = places[0].probability
    status = calibration.verdict(confidence, precision)
    if status == "ambiguous" and len(decided) == 1 and rival is None:  # there is nothing that it could be instead
        status = "no_match"
    if status == "no_match" and stand_out_together:
        status = "ambiguous"
    impostor, of_views = None, replace(ranking, impostors=None)
    if ranking.impostors and is_sure(first_features(of_views, ranking.rivals, usual, lowest, own_weight)):
        impostor = LIKE_ELSEWHERE if ranking.impostors.elsewhere else OF_NO_PLACE
    # A place that gets no more than wrong places usually do is to blame for nothing, unless it is taken for the first.
    blamed = rival is not None and (stand_out_together or bool(ranking.scores[rival] > usual.level))
    reason = reason_for(status, outrivalled=outrivalled and blamed, impostor=impostor, searched=searched)
    if not measured_alike:
        reason = Reason("weak", HISTOGRAMS_ALONE, "query with candidates above 0")
    return Decision(status, confidence, reason, precision, threshold, usual, places, confidences(places), first)


def shared(first: float, together: float, count: int) -> list[float]:
    """Probabilities of some places that look alike, each on condition that those before it are wrong.

    Parameters
    ----------
    first : float
        Probability of the best one, among all others.
    together : float
        Probability that it is any of them.
    count : int
        Number of the places, at least 2.

    Returns
    -------
    list of float
        They come to `together`: the best one keeps its own probability, if that is more than its share, and the others
        have equal parts of the rest.
    """
    best = max(first, together / count)
    other = max(together - best, 0.0) / (count - 1)
    left = (max(1 - best - before * other, 1e-12) for before in range(count - 1))
    return [best, *(min(other / rest, 1.0) for rest in left)]


def _in_turn(groups: Sequence[Sequence[int]], probabilities: Sequence[float]) -> tuple[PlaceProbability, ...]:
    """Probabilities of places, best first: each gets its own share of what the places before it leave of 1.

    The first places have a probability of their own; the others get 0.
    """
    places, left = [], 1.0
    for group, p in zip(groups, probabilities, strict=False):
        places.append(PlaceProbability(left * p, tuple(group)))
        left *= 1 - p
    return (*places, *(PlaceProbability(0.0, tuple(group)) for group in groups[len(places) :]))


def views_unlike(ranking: Ranking) -> list[int]:
    """Indices of the re-ranked views that the map itself can tell from the first, best first.

    Places that look alike to the map (floors of one building) may stand out together: the query then shows one of them,
    and is not of an unknown place.
    """
    first = int(ranking.seqs[0])
    return [i for i, seq in enumerate(ranking.seqs[: ranking.reranked]) if not ranking.places.alike(first, int(seq))]


def blame_image(decision: Decision, problem: str | None) -> Decision:
    """The decision with what is wrong with the image as its reason, unless it is `matched` or there was nothing to
    search; `problem` is in words."""
    if problem is None or decision.reason.code in ("sure", "empty"):
        return decision
    return replace(decision, reason=Reason("poor-picture", problem, BETTER_PHOTO))


def of_nothing(decision: Decision) -> Decision:
    """The decision on an image that shows nothing: none of the places, however like one of their views it is."""
    if not decision.places:
        return decision
    places = tuple(replace(place, probability=0.0) for place in decision.places)
    none = replace(decision, confidence=0.0, places=places, confidences=confidences(places))
    return replace(none, status="no_match", reason=NOTHING_SHOWN)


def confidences(places: Sequence[PlaceProbability]) -> tuple[float, ...]:
    """Of the views of some places, never rising with rank: the probability of each one's place."""
    of_view = {view: place.probability for place in places for view in place.views}
    return tuple(np.minimum.accumulate([of_view[view] for view in sorted(of_view)]).tolist())
