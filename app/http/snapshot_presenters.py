"""Turns snapshots and what is restored of them into the models of `schemas.wire`."""

from schemas import wire
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
