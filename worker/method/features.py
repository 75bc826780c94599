"""Features: the evidence for a place, relative to what wrong answers get in its map.

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

from collections.abc import Sequence
from dataclasses import replace
from math import hypot

import numpy as np

from schemas.comparisons import MapLevels
from worker.method.evidence import Ranking
from worker.method.places import ENOUGH_PLACES, ENOUGH_VIEWS

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
        Score of a picture that shows no place of the map; 0 without one.

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


def first_features(
    ranking: Ranking, others: Sequence[int], levels: MapLevels, least: float, own_weight: float
) -> dict[str, float]:
    """Features of the first place against other views and the impostors.

    `others` are the indices of those views in the ranking, best first; the rest is as `features` takes it.
    """
    score, rival = (float(ranking.scores[some[0]]) if some else 0.0 for some in ((0,), others))
    impostor = 0.0 if ranking.impostors is None else ranking.impostors.score
    return features(score, rival, levels, ranking.breadth(others), least, own_weight, impostor)
