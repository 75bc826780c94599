"""Turns snapshots and what is restored of them into the models of `schemas.wire`."""

from collections.abc import Callable

from schemas import wire
from schemas.removal import Removal
from schemas.snapshot import RestoredMap, SnapshotRecord


def snapshot(record: SnapshotRecord) -> wire.Snapshot:
    """A snapshot that the service keeps."""
    facts = record.facts
    return wire.Snapshot(
        id=facts.id,
        map=facts.map,
        created_at=facts.created_at,
        revision=facts.revision,
        recipe=facts.description.id,
        views=facts.views,
        image_bytes=facts.image_bytes,
        bytes=record.size,
        links={"self": f"/snapshots/{facts.id}", "map": f"/maps/{facts.map}"},
    )


def removal(receipt: Removal) -> wire.Deleted:
    """What a deletion removed, and which snapshots still have it."""
    return wire.Deleted(
        views=receipt.views,
        descriptions=receipt.descriptions,
        searched=receipt.searched,
        images=receipt.images,
        images_shared=receipt.images_shared,
        queries=receipt.queries,
        scores=receipt.scores,
        revision=receipt.revision,
        snapshots=[
            wire.HoldingSnapshot(id=one.id, map=one.map, created_at=one.created_at, views=one.views)
            for one in receipt.snapshots
        ],
    )


def allowed(receipt: wire.Deleted, may_use: Callable[[str], bool]) -> wire.Deleted:
    """A receipt as a key may see it: snapshots of maps that it does not allow are counted."""
    # One that cannot be read yet may be of any map, so that its id is told: it says nothing but that there is one.
    shown = [one for one in receipt.snapshots if one.map is None or may_use(one.map)]
    return receipt.model_copy(update={"snapshots": shown, "snapshots_of_others": len(receipt.snapshots) - len(shown)})


def restored(made: RestoredMap) -> wire.RestoredMap:
    """A map that was made from a snapshot."""
    return wire.RestoredMap(
        map=made.map,
        snapshot=made.snapshot,
        views=made.views,
        pending=made.pending,
        revision=made.revision,
        new_ids=made.new_ids,
        links={"map": f"/maps/{made.map}", "views": f"/views?map={made.map}"},
    )
