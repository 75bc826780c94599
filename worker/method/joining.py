"""Joining: from the decisions of several maps about one image to one verdict over all of them.

Each map says by itself how likely it is that the image shows one of its places, or none. Taken as evidence that does
not depend on the other maps, the odds ``p / none`` of a place add up: over all maps

    P(place k of map i) = (p_ik / none_i) / (1 + sum over maps j of (sum over places of p_j) / none_j).

The probabilities of all places and of none of them sum to 1. Another map can only lower that of a place: a house of
three floors that look alike is not three times as sure.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from worker.method.calibration import Verdict
from worker.method.decision import Decision, PlaceProbability, Reason

NEVER_SURE = 1e-6
"""Probability that every map leaves for none of its places: two maps cannot both be certain."""

OTHER_MAP = Reason(
    "look-alike",
    "the first place would be sure if a place of another map were not nearly as good",
    "look at the rival: enrol more views of both places where they differ, take the photo so that this shows, or "
    "query fewer maps",
)


@dataclass(frozen=True)
class Joined:
    """One decision over several maps.

    Parameters
    ----------
    parts : tuple of Decision
        Of each map, with probabilities among the places of all maps; the rest as the map says by itself.
    leading : int
        Index of the map with the most probable place.
    decision : Decision
        That part, with the verdict on all maps and the reason for it.
    rival : int or None
        Index of the map whose first place keeps that of the leading one from being matched.
    nowhere : float
        Probability that the image shows no place of any map.
    """

    parts: tuple[Decision, ...]
    leading: int
    decision: Decision
    rival: int | None
    nowhere: float


def join(decisions: Sequence[Decision]) -> Joined:
    """One decision over the maps that made these, at least one.

    Notes
    -----
    An answer is `matched` where its joined probability reaches the threshold of its own map, `no_match` where each map
    says that by itself, and else `ambiguous`.
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


def _scaled(decision: Decision, factor: float) -> Decision:
    return replace(
        decision,
        confidence=decision.confidence * factor,
        places=tuple(PlaceProbability(place.probability * factor, place.views) for place in decision.places),
        confidences=tuple(confidence * factor for confidence in decision.confidences),
    )
