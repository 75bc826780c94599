"""Decision: from a ranking to probabilities of places, one verdict, and the reason for it.

What a wrong view scores differs from map to map: 0.2 among ten parks, 0.6 in a corridor of equal doors. A score says
little by itself. These features say more, and mean the same in every map:

- ``gap``: by how much the best view of a place exceeds the best view of any other place, measured in the gaps that
  wrong answers have in this map. The map finds these out itself, by being queried with its own views, their places left
  out (`schemas.comparisons.Comparison`).
- ``level``: by how much the score falls short of what wrong answers get in this map.
- ``breadth``: over how much of the image the place leads (`worker.method.breadth`), in the breadths that leads of wrong
  answers have in this map.
- ``own``: how near the score comes to what views of one place get of each other in this map; where the rival gets
  less than wrong answers do, in other light, that much less is asked of it.
- ``either``: `breadth` and `own` as the sides of a right angle. A broad lead needs no high score, nor this that.

`own` says that the query shows something like the place, not which of two that look alike. It counts the less, the more
keypoints of another place agree with the query too. The curve that ships reads all but `own` itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import hypot
from typing import Literal

import numpy as np

from schemas.comparisons import MapLevels
from worker.method.calibration import Calibration, Verdict
from worker.method.evidence import Ranking
from worker.method.places import ENOUGH_PLACES, ENOUGH_VIEWS

USUAL_BREADTH = 2.0
USUAL_OWN = 0.7
"""What sure views of one place get of each other over other maps."""

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

FEW_VIEWS = 5
"""With fewer searched views than this, an answer that stands out from nothing says so."""

Code = Literal["sure", "look-alike", "weak", "few-views", "poor-picture", "empty"]


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
class Reason:
    """Why the verdict is what it is.

    Parameters
    ----------
    code : str
        ``sure``; ``look-alike``: another place is as good; ``weak``: nothing stands out from what wrong places get;
        ``few-views``: too little is enrolled to tell; ``poor-picture``; ``empty``: there was nothing to search.
    detail, remedy : str
        What was seen, and what to do.
    """

    code: Code
    detail: str
    remedy: str


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
    compared with few views of other places."""
    own = own_share(levels)
    broad = USUAL_BREADTH if levels.breadth is None else levels.breadth
    lead = levels.gap or PRIOR.gap  # 0: no view was compared with two other places
    level, gap, breadth = (
        own * mine + (1 - own) * usual
        for mine, usual in ((levels.level, PRIOR.level), (lead, PRIOR.gap), (broad, USUAL_BREADTH))
    )
    paired = levels.paired / (levels.paired + PRIOR.compared)
    pair = USUAL_OWN if levels.own is None else paired * levels.own + (1 - paired) * USUAL_OWN
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
    counts: float = 0.0,
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
    counts : float
        What `own` counts, 0..1 (`tells_apart`): 0 for a place that is not the first.
    impostor : float
        Score of a picture that shows no place; 0 without one.
    """
    lead, left = (max(score - other, 0.0) for other in (rival, max(rival, least, impostor)))
    broad = breadth * (left / lead) ** NARROWING if lead > 0 else 0.0
    near = float(np.log((score + SOFTENING) / ((levels.own or USUAL_OWN) + SOFTENING)))
    # In other light everything scores less than the map's own views do: by how much, the rival tells.
    near += max(float(np.log((levels.level + SOFTENING) / (max(rival, impostor, LEAST_RIVAL) + SOFTENING))), 0.0)
    own = counts * (min(max(near, LEAST_OWN), MOST_OWN) - LEAST_OWN)
    wide = float(np.log1p(broad / ((levels.breadth or 0.0) + BREADTH_SOFTENING)))
    return {
        "gap": float(np.log1p(left / (levels.gap + SOFTENING))),
        "level": min(float(np.log((score + SOFTENING) / (levels.level + SOFTENING))), 0.0),
        "breadth": wide,
        "own": own,
        "either": hypot(wide, OWN_AS_BREADTH * own),
    }


def tells_apart(rival_inliers: int | None, others: int) -> float:
    """What evidence for a place counts that a look-alike would have too, 0..1.

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
        Whether the views of the map were compared with one another by the same stages as the query: what wrong answers
        get by others says nothing.

    Notes
    -----
    The probability of a place depends on its best view, the best view of any other place, and the map: more views of
    the place can only raise it. That of the second place is the probability that the first is wrong times what the
    curve says of the second, and so on, so that all of them and "none" sum to 1. Places of which no view is among the
    first `GROUPED` have 0: else that of none, and of the places of other searches, would depend on `shown`.
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
    counts = tells_apart(ranking.rival_inliers, ranking.others)
    undisputed = tells_apart(None if ranking.rival_inliers is None else 0, ranking.others)
    lowest = least if measured_alike else 1.0

    def probability(of: Mapping[str, float]) -> float:
        return calibration.probabilities([of])[0]

    first = first_features(ranking, ranking.rivals, usual, lowest, counts)
    read = [first, *(features(score, scores[0], usual) for score in scores[1:])]
    places, left = [], 1.0
    for group, p in zip(decided, calibration.probabilities(read), strict=True):
        places.append(PlaceProbability(left * p, tuple(group)))
        left *= 1 - p
    places += [PlaceProbability(0.0, tuple(group)) for group in groups[len(decided) :]]
    confidence = places[0].probability
    status = calibration.verdict(confidence, precision)
    if status == "ambiguous" and len(decided) == 1 and rival is None:  # there is nothing that it could be instead
        status = "no_match"
    # Whether the first place would be matched if there were no other place, and below, if there were no impostors.
    outrivalled = rival is not None and probability(first_features(ranking, (), usual, least, undisputed)) >= threshold
    if status == "no_match" and outrivalled and rival is not None and ranking.places.alike(seqs[0], seqs[rival]):
        # Places that the map itself takes for each other stand out together: it is one of them.
        together = first_features(ranking, views_unlike(ranking), usual, least, counts)
        if probability(together) >= threshold:
            status = "ambiguous"
    of_views = replace(ranking, impostors=None)
    of_no_place = probability(first_features(of_views, ranking.rivals, usual, lowest, counts)) >= threshold
    reason = _reason(status, outrivalled, of_no_place, searched)
    if not measured_alike:
        reason = Reason("weak", HISTOGRAMS_ALONE, "query with candidates above 0")
    return Decision(status, confidence, reason, precision, threshold, usual, tuple(places), confidences(places), first)


def first_features(
    ranking: Ranking, others: Sequence[int], levels: MapLevels, least: float, counts: float
) -> dict[str, float]:
    """Features of the first place against other views, by their indices, best first, and against the impostors."""
    score, rival = (float(ranking.scores[some[0]]) if some else 0.0 for some in ((0,), others))
    impostor = 0.0 if ranking.impostors is None else ranking.impostors.score
    return features(score, rival, levels, ranking.breadth(others), least, counts, impostor)


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


BETTER_PHOTO = "take another photo of the place: lit, sharp, and of things that stay"
NOTHING_SHOWN = Reason("poor-picture", "the image shows nothing", BETTER_PHOTO)


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


EMPTY = Reason("empty", "there was no view to compare with", "enrol images, or widen the filters")
HISTOGRAMS_ALONE = "ranked by histograms alone, by which the map does not know what wrong answers get"
OF_NO_PLACE = Reason(
    "weak",
    "the first place stands out from the others, but hardly from pictures that show no place, such as a wall close by, "
    "the sky, or a page of text",
    "take the photo so that more of the place shows",
)
SURE = Reason("sure", "one place stands out from all others", "nothing")


def _reason(status: Verdict, outrivalled: bool, of_no_place: bool, searched: int) -> Reason:
    """Why; `outrivalled`: without its rival the first place would be matched; `of_no_place`: without the impostors."""
    if status == "matched":
        return SURE
    if outrivalled:
        return Reason(
            "look-alike",
            "the first place would be sure if another place were not nearly as good",
            "look at the rival: enrol more views of both places where they differ, take the photo so that this shows, "
            "or narrow the search with near or place",
        )
    if of_no_place:
        return OF_NO_PLACE
    if searched < FEW_VIEWS:
        return Reason(
            "few-views",
            f"only {searched} view{'s' * (searched != 1)} could be searched: too few to tell what a wrong place gets",
            "enrol more views, of this place and of others",
        )
    return Reason(
        "weak",
        "no place stands out from what wrong places get in this map",
        "if the place is enrolled, enrol it from here and in this light too",
    )
