import inspect
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import numpy as np
import pytest

from schemas.errors import Unavailable
from schemas.records import Position, ViewAttributes
from worker.method.cascade import ViewGone
from worker.service.map_answers import ROUNDS
from worker.service.shadow_answers import Side, search
from worker.service.shadows import PORTION, ShadowService


class GoneIndex:
    """An index in the database, whose map changes over whenever it is searched."""

    def __init__(self) -> None:
        self.searched = 0

    def search(self, *_: Any) -> Any:
        self.searched += 1
        raise ViewGone


def test_an_index_that_is_gone_is_searched_again_and_then_given_up_with_a_reason() -> None:
    index = GoneIndex()
    recipe = SimpleNamespace(description=None, ranking=SimpleNamespace(searched=50))
    parts = inspect.signature(Side).parameters
    side = Side(**{name: cast(Any, None) for name in parts} | {"recipe": cast(Any, recipe), "index": cast(Any, index)})

    query = cast(Any, SimpleNamespace(vectors={}))

    with pytest.raises(Unavailable, match="try again"):
        search(side, query, np.array([1, 2]), None)

    assert index.searched == ROUNDS


def at(seq: int, z: float) -> Any:
    """A view at one spot, so high above the ground."""
    return SimpleNamespace(seq=seq, map="campus", attributes=ViewAttributes("hall", Position(x=1.0, y=1.0, z=z)))


@pytest.mark.parametrize(("height", "known", "read"), [(0.0, True, PORTION), (30.0, False, 3000)])
def test_of_a_place_of_thousands_a_few_views_tell_that_it_is_known(height: float, known: bool, read: int) -> None:
    listings, views = Mock(), Mock()
    listings.select.return_value = SimpleNamespace(only=np.arange(3001))
    views.at.side_effect = lambda seqs: {seq: at(seq, height) for seq in seqs}
    parts = {name: Mock() for name in inspect.signature(ShadowService).parameters}
    shadows = ShadowService(**parts | {"listings": listings, "views": views})
    assert shadows._is_known(at(0, 0.0), 5.0) == known
    assert sum(len(call.args[0]) for call in views.at.call_args_list) == read
