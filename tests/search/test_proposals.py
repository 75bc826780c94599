"""Which kept queries of one place agree, however many there are."""

import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from unittest.mock import Mock

import numpy as np
import pytest

from schemas.errors import Conflict
from schemas.inbox import KeptQuery, Proposals
from worker.service.proposals import STILL, ProposalService

NOW = datetime(2026, 1, 1, tzinfo=UTC)


def query(number: int, moved: float = 0.0, recipe: str = "recipe") -> KeptQuery:
    """A query whose histogram lies so far from that of a camera that stands still."""
    vectors = np.array([1.0 + moved, *(0.0,) * 255], np.float32)
    return KeptQuery(f"query {number:04}", recipe, NOW, vectors, None, 1, 0.5)


def proposals(queries: Sequence[KeptQuery]) -> Proposals:
    """The proposals of a map whose one view all of them matched."""
    kept, views = Mock(), Mock()
    kept.newest.return_value = list(queries), len(queries)
    views.at.return_value = {1: Mock(id="view", **{"attributes.place": "gate"})}
    return ProposalService(maps=Mock(), views=views, kept=kept, enroll=Mock()).of("campus")


def confirmed(*queries: KeptQuery) -> list[str]:
    [proposal] = proposals(queries).proposals
    return list(proposal.confirmed)


def test_queries_agree_where_one_is_of_another_image_than_the_camera_that_stands_still() -> None:
    still = [query(number, 0.9 * STILL * (number % 2)) for number in range(4)]
    assert confirmed(*still) == confirmed(query(0)) == []
    assert confirmed(*still, query(4, 1.5 * STILL)) == ["query 0000", "query 0002", "query 0004"]
    assert confirmed(*still, query(4, 2 * STILL)) == [f"query {number:04}" for number in range(5)]
    assert confirmed(query(0), query(1, recipe="next")) == ["query 0000", "query 0001"]


def test_each_query_of_a_camera_that_stands_still_is_looked_at_as_often_among_many() -> None:
    def calls(count: int) -> int:
        """Functions that are called for so many queries."""
        made, counted = 0, [query(number) for number in range(count)]

        def count_one(*_: object) -> None:
            nonlocal made
            made += 1

        sys.setprofile(count_one)
        try:
            proposals(counted)
        finally:
            sys.setprofile(None)
        return made

    calls(2)
    assert (calls(400) - calls(200)) / 200 < 1.2 * (calls(200) - calls(2)) / 198


def test_a_proposal_stays_whose_images_cannot_be_enrolled_now() -> None:
    """As where the running encoder knows nothing that the map blurs: what is refused is no photo that is there."""
    kept, views, enroll = Mock(), Mock(), Mock()
    kept.newest.return_value = [query(0), query(1, 2 * STILL)], 2
    views.at.return_value = {1: Mock(id="view", **{"attributes.place": None})}
    views.get.return_value = Mock(**{"attributes.place": None, "attributes.position": None})
    enroll.take.side_effect = Conflict("the encoder finds no window, which the map blurs")
    service = ProposalService(maps=Mock(), views=views, kept=kept, enroll=enroll)
    with pytest.raises(Conflict, match="finds no window"):
        service.accept("campus", "query 0000", 3, unconfirmed=False)
    kept.delete.assert_not_called()
