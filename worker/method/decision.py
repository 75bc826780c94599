"""Decision: from a ranking to probabilities of places, one verdict, and the reason for it.

What a wrong view scores differs from map to map: 0.2 among ten parks, 0.6 in a corridor of equal doors. A score says
little by itself. These features say more, and mean the same in every map:

- ``gap``: the lead of a place, which is the score of its best view less that of the best view of any other place, in
  units of the lead that wrong answers have in this map. The map learns these units by being queried with its own views,
  their places left out (`schemas.comparisons.Comparison`).
- ``level``: by how much the score falls short of what wrong answers get in this map; 0 where it does not.
- ``breadth``: over how much of the image the place leads (`worker.method.breadth`), in units of the breadth that leads
  of wrong answers have in this map.
- ``own``: how near the score comes to what views of one place get of each other in this map. In other light all views
  score less: by as much as the rival scores less than wrong answers do, less is asked of the first place too.
- ``either``: `breadth` and `own` as the sides of a right angle. A broad lead needs no high score, and a high score no
  broad lead.

`own` says that the query shows something like the place, but not which of two places that look alike. It counts for
less the more keypoints of another place agree with the query too. The shipped curve reads all features but `own`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from math import hypot

import numpy as np

from schemas.comparisons import MapLevels
from worker.method.calibration import Calibration, Verdict
from worker.method.evidence import Ranking
from worker.method.places import ENOUGH_PLACES, ENOUGH_VIEWS
from worker.method.reasons import BETTER_PHOTO, EMPTY, HISTOGRAMS_ALONE, NOTHING_SHOWN, Reason, reason_for

USUAL_BREADTH = 2.0
USUAL_OWN = 0.7
"""What sure views of one place get of each other over other maps, and at least in this one."""

PRIOR = MapLevels(compared=4, level=0.25, gap=0.03, breadth=USUAL_BREADTH)
"""What wrong answers get in maps of streets, parks and rooms, and how many compared views that is worth."""

LOOK_ALIKE = 0.4
"""What wrong answers get where everything looks alike, as in a corridor or on the floors of one building."""

SOFTENING = 0.02
"""Added to scores in ratios and to the gap of wrong answers, so that small ones do not decide by their noise."""

BREADTH_SOFTENING = 1.0
"""The same for the breadth of wrong answers."""

NARROWING = 0.25
"""Power of the share of a lead that a floor leaves, by which the lead gets narrower: cells do not know of the floor."""

GROUPED = 10
"""Views that are grouped into places at least; those further down the ranking never decide."""

LEAST_RIVAL = 0.05
"""Score of the rival from which on it tells how much less than the map's own views everything scores."""

LEAST_OWN, MOST_OWN = -1.0, -0.5
"""Logarithms of the ratio of a score to what views of one place get, between which it is evidence: .37 to .61 of it. In
other light a right view gets no more than that, in the same light a look-alike does."""

OWN_AS_BREADTH = 3.0
"""What `own` counts beside `breadth` in `either`."""

ALIKE_INLIERS = 10.0
"""Inliers of another place that halve what `own` is worth."""

FEW_OTHERS = 0.25
"""Power of the share of `ENOUGH_PLACES` enrolled besides, by which it counts less: unknown twins are likelier."""


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


def expected_levels(levels: MapLevels) -> MapLevels:
    """What wrong answers get in a map: its own means, mixed with `PRIOR` while few of its views are compared, or are
    compared with few views of other places; and what sure views of one place get, at least `USUAL_OWN`."""
    own = own_share(levels)
    broad = USUAL_BREADTH if levels.breadth is None else levels.breadth
    lead = levels.gap or PRIOR.gap  # 0: no view was compared with two other places
    level, gap, breadth = (
        own * mine + (1 - own) * usual
        for mine, usual in ((levels.level, PRIOR.level), (lead, PRIOR.gap), (broad, USUAL_BREADTH))
    )
    paired = levels.paired / (levels.paired + PRIOR.compared)
    # Views of one place that face different ways get little of each other, and do not tell what a sure one gets.
    pair = max(paired * (levels.own or 0.0) + (1 - paired) * USUAL_OWN, USUAL_OWN)
    return replace(levels, level=level, gap=gap, breadth=breadth, own=pair)


def own_share(levels: MapLevels) -> float:
    """How much of `expected_levels` a map's own views decide, 0..1."""
    own = levels.compared * min(1.0, levels.others / ENOUGH_VIEWS)
    return own / (own + PRIOR.compared)


def floor(others: int, levels: MapLevels) -> float:
    """Score that the rival is taken to have at least: views of few other places do not tell what wrong answers get.

    0 where there are `ENOUGH_PLACES` others; else the level of the map, and nearer to `LOOK_ALIKE` the fewer there are
    and the less the map knows of itself. A search that filters narrow down in a large map has the map's own level.
    """
    if others >= ENOUGH_PLACES:
        return 0.0
    missing = 1 - max(others, 0) / ENOUGH_PLACES
    return levels.level + max(LOOK_ALIKE - levels.level, 0.0) * missing**2 * (1 - own_share(levels))


def features(
    score: float,
    rival: float,
    levels: MapLevels,
    breadth: float = 0.0,
    least: float = 0.0,
    own_weight: float = 0.0,
    impostor: float = 0.0,
) -> dict[str, float]:
    """Features of a place; each grows with the evidence for it.

    Parameters
    ----------
    score : float
        Of its best view, 0..1.
    rival : float
        Of the best view of any other place, 0..1.
    levels : MapLevels
        As `expected_levels` gives them.
    breadth : float
        Of the lead over that view, at least 0.
    least : float
        Score that the rival is taken to have at least (`floor`); what is left of the lead is a little less broad.
    own_weight : float
        What `own` counts, 0..1 (`tells_apart`): 0 for a place that is not the first.
    impostor : float
        Score of a picture that shows no place; 0 without one.

    Notes
    -----
    With the score s, the rival's score r, and l, the lead over the largest of `rival`, `least` and `impostor`
    (S is `SOFTENING`, B is `BREADTH_SOFTENING`)::

        gap     = log(1 + l / (levels.gap + S))
        level   = min(0, log((s + S) / (levels.level + S)))
        breadth = log(1 + breadth (l / (s - r))^NARROWING / (levels.breadth + B))
        near    = log((s + S) / (levels.own + S)) + max(0, log((levels.level + S) / (q + S)))
        own     = own_weight (near - LEAST_OWN), near within LEAST_OWN..MOST_OWN
        either  = sqrt(breadth^2 + (OWN_AS_BREADTH own)^2)

    where q is the largest of r, `impostor` and `LEAST_RIVAL`.
    """
    lead, left = (max(score - other, 0.0) for other in (rival, max(rival, least, impostor)))
    broad = breadth * (left / lead) ** NARROWING if lead > 0 else 0.0
    near = float(np.log((score + SOFTENING) / ((levels.own or USUAL_OWN) + SOFTENING)))
    # In other light everything scores less than the map's own views do: by how much, the rival tells.
    near += max(float(np.log((levels.level + SOFTENING) / (max(rival, impostor, LEAST_RIVAL) + SOFTENING))), 0.0)
    own = own_weight * (min(max(near, LEAST_OWN), MOST_OWN) - LEAST_OWN)
    wide = float(np.log1p(broad / ((levels.breadth or 0.0) + BREADTH_SOFTENING)))
    return {
        "gap": float(np.log1p(left / (levels.gap + SOFTENING))),
        "level": min(float(np.log((score + SOFTENING) / (levels.level + SOFTENING))), 0.0),
        "breadth": wide,
        "own": own,
        "either": hypot(wide, OWN_AS_BREADTH * own),
    }


def tells_apart(rival_inliers: int | None, others: int) -> float:
    """Weight of evidence that a look-alike of the place would have too, 0..1.

    Parameters
    ----------
    rival_inliers : int or None
        Largest number of any other place; None where nothing was verified: then nobody knows, and it counts nothing.
    others : int
        Number of other places.
    """
    if rival_inliers is None:
        return 0.0
    enough = min(others / ENOUGH_PLACES, 1.0) ** FEW_OTHERS
    return float(enough / (1 + rival_inliers / ALIKE_INLIERS))


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
    of_views = replace(ranking, impostors=None)
    of_no_place = is_sure(first_features(of_views, ranking.rivals, usual, lowest, own_weight))
    # A place that gets no more than wrong places usually do is to blame for nothing, unless it is taken for the first.
    blamed = rival is not None and (stand_out_together or bool(ranking.scores[rival] > usual.level))
    reason = reason_for(status, outrivalled=outrivalled and blamed, of_no_place=of_no_place, searched=searched)
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


def first_features(
    ranking: Ranking, others: Sequence[int], levels: MapLevels, least: float, own_weight: float
) -> dict[str, float]:
    """Features of the first place against other views and the impostors.

    `others` are the indices of those views in the ranking, best first; the rest is as `features` takes it.
    """
    score, rival = (float(ranking.scores[some[0]]) if some else 0.0 for some in ((0,), others))
    impostor = 0.0 if ranking.impostors is None else ranking.impostors.score
    return features(score, rival, levels, ranking.breadth(others), least, own_weight, impostor)


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
