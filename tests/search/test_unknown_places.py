"""Kept queries by spot: each spot is told once, and what was found of two queries is not looked for again."""

from datetime import UTC, datetime
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from schemas.inbox import KeptQuery
from worker.service import inbox
from worker.service.inbox import NEAREST, InboxService

NOW = datetime(2026, 1, 1, tzinfo=UTC)
SPOTS = 30


def query(number: int) -> Any:
    """A query at one of the spots, by turns."""
    vectors = np.array([number % SPOTS, number / 1000], np.float32)
    return KeptQuery(f"query {number:04}", "recipe", NOW, vectors, SimpleNamespace(spot=number % SPOTS), None)  # type: ignore[arg-type]


@pytest.fixture
def looked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many queries were compared with another one, each time."""
    counts: list[int] = []

    def verify(one: Any, others: list[Any]) -> list[Any]:
        counts.append(len(others))
        return [SimpleNamespace(inliers=100 * (one.spot == other.spot)) for other in others]

    monkeypatch.setattr(inbox, "verify", verify)
    return counts


def test_a_list_of_unknown_places_compares_only_what_no_list_before_did(looked: list[int]) -> None:
    kept = Mock()
    queries = [query(number) for number in range(200)]
    service = InboxService(maps=Mock(), kept=kept, enroll=Mock())

    def listed() -> list[tuple[str, ...]]:
        kept.newest.return_value = queries, len(queries)
        return [place.queries for place in service.of("campus").places]

    before = listed()
    assert len(before) == SPOTS
    at_first = sum(looked)
    assert at_first > SPOTS
    looked.clear()
    assert listed() == before
    assert sum(looked) == 0

    gone = set(before[0])
    queries = [one for one in queries if one.id not in gone]
    assert listed() == before[1:]
    assert sum(looked) < NEAREST

    queries = [*queries, query(200 + SPOTS)]
    looked.clear()
    listed()
    assert 0 < sum(looked) <= SPOTS


def test_a_spot_is_one_place_however_often_it_was_queried(looked: list[int]) -> None:
    """A robot waits at a door that the map lacks, and asks all morning."""
    queries = [query(SPOTS * number) for number in range(10 * NEAREST)]
    kept = Mock()
    kept.newest.return_value = queries, len(queries)
    [door] = InboxService(maps=Mock(), kept=kept, enroll=Mock()).of("campus").places
    assert door.queries == tuple(one.id for one in queries)
    assert sum(looked) < len(queries)
