"""Pages of examples, of a map that does not fit into memory."""

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

from app.http.compreface import ExamplePage, Examples
from app.http.curate import Curator
from app.http.routes.compreface import PAGE, examples
from schemas.records import Filters

VIEWS = 20 * PAGE


class Counted:
    """A view that counts how many there are at a time."""

    now = most = 0

    def __init__(self, number: int) -> None:
        self.id, self.place = str(number), "hall"
        Counted.now += 1
        Counted.most = max(Counted.most, Counted.now)

    def __del__(self) -> None:
        Counted.now -= 1


class LargeMap:
    """`Curator` of a map with `VIEWS` views."""

    def __init__(self) -> None:
        self.pages = 0

    async def map(self, name: str) -> Any:
        return SimpleNamespace(views={"ready": VIEWS - 1, "failed": 1})

    async def views(self, name: str, filters: Filters, *, cursor: str | None, limit: int, **_: object) -> Any:
        self.pages += 1
        first = int(cursor or 0)
        views = [Counted(number) for number in range(first, min(first + limit, VIEWS))]
        return SimpleNamespace(views=views, next=str(first + limit) if first + limit < VIEWS else None)


def listed(curator: LargeMap, **wanted: Any) -> ExamplePage:
    return asyncio.run(examples("town", Examples(**wanted), cast(Curator, curator)))


@pytest.mark.parametrize("subject", [None, "hall"])
@pytest.mark.parametrize(("page", "size"), [(0, 20), (3, PAGE), (VIEWS // 20 - 1, 20), (1, VIEWS - 7), (VIEWS, 20)])
def test_a_page_takes_no_more_memory_than_it_has_examples(subject: str | None, page: int, size: int) -> None:
    Counted.most = Counted.now
    curator = LargeMap()

    answer = listed(curator, page=page, size=min(size, 10_000), subject=subject)

    numbers = range(VIEWS)[page * size : (page + 1) * size]
    assert [one.image_id for one in answer.faces] == [str(number) for number in numbers]
    assert (answer.total_elements, answer.total_pages) == (VIEWS, -(-VIEWS // size))
    assert Counted.most <= len(numbers) + 2 * PAGE
    if subject is None:
        assert curator.pages == -(-min((page + 1) * size, VIEWS) // PAGE) * (page * size < VIEWS)
