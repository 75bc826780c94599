"""Receipts of deletions, as they are sent, and as a key may see them."""

from datetime import UTC, datetime

from app.http.snapshot_presenters import allowed, removal
from schemas.removal import Holding, Removal

MADE = datetime(2026, 11, 24, 9, tzinfo=UTC)
RECEIPT = Removal(
    views=3,
    images=2,
    revision=44,
    queries=1,
    scores=6,
    descriptions=4,
    searched=2,
    images_shared=1,
    snapshots=(Holding("a", "campus", MADE, 3), Holding("b", "attic", MADE, 1), Holding("c", None, None, None)),
)


def test_a_receipt_says_what_is_gone_from_where_and_what_is_left() -> None:
    assert removal(RECEIPT).model_dump(mode="json") == {
        "views": 3, "descriptions": 4, "searched": 2, "images": 2, "images_shared": 1, "queries": 1, "scores": 6,
        "revision": 44,
        "snapshots": [
            {"id": "a", "map": "campus", "created_at": "2026-11-24T09:00:00.000000Z", "views": 3},
            {"id": "b", "map": "attic", "created_at": "2026-11-24T09:00:00.000000Z", "views": 1},
            {"id": "c", "map": None, "created_at": None, "views": None},
        ],
        "snapshots_of_others": 0,
    }  # fmt: skip


def test_snapshots_of_maps_that_a_key_does_not_allow_are_counted() -> None:
    seen = allowed(removal(RECEIPT), lambda name: name == "campus")
    assert ([one.id for one in seen.snapshots], seen.snapshots_of_others) == (["a", "c"], 1)
    assert "attic" not in seen.model_dump_json()
