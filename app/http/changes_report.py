"""Turns what changed at a place into the models of `schemas.wire`."""

from collections.abc import Sequence
from typing import Literal

from schemas import wire
from schemas.errors import Busy, NotFound
from worker.method.changes import Change
from worker.method.lost_regions import Spot
from worker.service.changes import Comparison


def changes(comparison: Comparison, drawing: str) -> wire.Changes:
    """What changed, or why that cannot be said; `drawing` is the address of its drawing."""
    found, recipe = comparison.found, comparison.recipe
    told = () if found is None or recipe is None else [_change(one, recipe.labels) for one in found.changes]
    return wire.Changes(
        status=comparison.status,
        detail=comparison.detail or None,
        since=comparison.since,
        compared=0.0 if found is None else found.compared,
        similarity=None if found is None else found.similarity,
        changes=list(told),
        links={"drawing": drawing} if comparison.status in ("compared", "not-aligned") else {},
    )


def put_off(refused: Busy, query_id: str) -> wire.Changes:
    """The report for a query that was answered while a full queue refused to compare its photos: when to ask again."""
    return _nothing("busy", f"{refused.detail}; get /queries/{query_id}/changes in {refused.retry_after_s} s")


def no_longer_kept(gone: NotFound) -> wire.Changes:
    """The report for a query that was answered while its photo was forgotten, or the view that it matched deleted."""
    return _nothing("image-not-kept", gone.detail)


def _nothing(status: Literal["busy", "image-not-kept"], why: str) -> wire.Changes:
    return wire.Changes(status=status, detail=why, since=None, compared=0.0, similarity=None, changes=[], links={})


def _change(change: Change, labels: Sequence[str]) -> wire.Change:
    return wire.Change(
        kind=change.kind,
        label=labels[change.label],
        instead=None if change.instead is None else labels[change.instead],
        confidence=change.confidence,
        then=_spot(change.then),
        now=_spot(change.now),
    )


def _spot(spot: Spot | None) -> wire.Spot | None:
    return None if spot is None else wire.Spot(centre=spot.centre, extent=spot.extent, share=spot.share)
