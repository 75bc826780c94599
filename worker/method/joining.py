"""Joining: from the decisions of several searches about one image to one verdict over all of them.

Maps of one recipe are searched and ranked together, as one map. Those of different recipes have scores that cannot be
compared, but each says how likely it is that the image shows one of its places, or none. Taken as evidence that does
not depend on the other searches, the odds ``p / none`` of a place add up: over all searches

    P(place k of search i) = (p_ik / none_i) / (1 + sum over searches j of (sum over places of p_j) / none_j).

The probabilities of all places and of none of them sum to 1. Another search can only lower that of a place.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from schemas.comparisons import MapLevels
from worker.method.calibration import Verdict
from worker.method.decision import Decision, PlaceProbability
from worker.method.reasons import Reason

NEVER_SURE = 1e-6
"""Probability that every search leaves for none of its places: two cannot both be certain."""

OTHER_MAP = Reason(
    "look-alike",
    "the first place would be sure if a place of another map were not nearly as good",
    "look at the rival: enrol more views of both places where they differ, take the photo so that this shows, or "
    "query fewer maps",
)


@dataclass(frozen=True)
class Joined:
    """One decision over several searches.

    Parameters
    ----------
    parts : tuple of Decision
        Of each search, with probabilities among the places of all; the rest as it says by itself.
    leading : int
        Index of the search with the most probable place.
    decision : Decision
        That part, with the verdict on all searches and the reason for it.
    rival : int or None
        Index of the search whose first place keeps that of the leading one from being matched.
    nowhere : float
        Probability that the image shows none of the places.
    """

    parts: tuple[Decision, ...]
    leading: int
    decision: Decision
    rival: int | None
    nowhere: float


def join(decisions: Sequence[Decision]) -> Joined:
    """One decision over the searches that made these, at least one.

    Notes
    -----
    An answer is `matched` where its joined probability reaches the threshold of its own search, `no_match` where each
    search says that by itself, and else `ambiguous`.
    """
    if len(decisions) == 1:
        return Joined((decisions[0],), 0, decisions[0], None, decisions[0].nowhere)
    none = [max(one.nowhere, NEVER_SURE) for one in decisions]
    known = [sum(place.probability for place in one.places) for one in decisions]
    total = 1 + sum(p / n for p, n in zip(known, none, strict=True))
    parts = tuple(_scaled(one, 1 / (n * total)) for one, n in zip(decisions, none, strict=True))
    leading, *others = sorted(range(len(parts)), key=lambda i: (-parts[i].confidence, not parts[i].places))
    first, alone = parts[leading], decisions[leading]
    status: Verdict = "no_match"
    if alone.status == "matched" and first.confidence >= alone.threshold:
        status = "matched"
    elif any(one.status != "no_match" for one in decisions):
        status = "ambiguous"
    rivalled = alone.status == "matched" and status != "matched"
    decision = replace(first, status=status, reason=OTHER_MAP if rivalled else alone.reason)
    return Joined(parts, leading, decision, others[0] if rivalled else None, 1 / total)


def pooled(levels: Sequence[MapLevels]) -> MapLevels:
    """What wrong answers get in several maps taken together: means over their compared views.

    A map of two places knows of no lead, and one that was just made of nothing: they say nothing of what they lack.
    """
    compared = sum(one.compared for one in levels)
    if len(levels) == 1 or compared == 0:
        return levels[0]
    paired = sum(one.paired for one in levels)
    return MapLevels(
        compared=compared,
        level=_mean([(one.level, one.compared) for one in levels]) or 0.0,
        gap=_mean([(one.gap or None, one.compared) for one in levels]) or 0.0,
        others=sum(one.others for one in levels),
        updated_at=max((one.updated_at for one in levels if one.updated_at is not None), default=None),
        breadth=_mean([(one.breadth, one.compared) for one in levels]),
        own=sum((one.own or 0.0) * one.paired for one in levels) / paired if paired else None,
        paired=paired,
        current=sum(one.current for one in levels),
    )


def _mean(values: Sequence[tuple[float | None, int]]) -> float | None:
    """Mean of values by how much each counts; None where none is known that counts."""
    known = [(value, count) for value, count in values if value is not None and count > 0]
    total = sum(count for _, count in known)
    return sum(value * count for value, count in known) / total if total else None


def _scaled(decision: Decision, factor: float) -> Decision:
    return replace(
        decision,
        confidence=decision.confidence * factor,
        places=tuple(PlaceProbability(place.probability * factor, place.views) for place in decision.places),
        confidences=tuple(confidence * factor for confidence in decision.confidences),
    )
