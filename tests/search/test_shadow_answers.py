from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from schemas.errors import Unavailable
from worker.method.cascade import ViewGone
from worker.service.shadow_answers import ROUNDS, Side, search


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
    side = cast(
        Side, SimpleNamespace(recipe=recipe, index=index, fetcher=SimpleNamespace(without_fixed=lambda query: query))
    )

    query = cast(Any, SimpleNamespace(vectors={}))

    with pytest.raises(Unavailable, match="try again"):
        search(side, query, np.array([1, 2]), None, cast(Any, None))

    assert index.searched == ROUNDS
