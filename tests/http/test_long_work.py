"""What takes long keeps nobody else from a thread."""

import asyncio
import json
import threading
from collections.abc import Awaitable, Callable
from unittest.mock import Mock

import pytest

from app.http.curate import DRAWN_AT_ONCE, Curator
from app.http.recognise import Recogniser
from schemas import wire
from schemas.records import ViewAttributes
from tests import answers
from tests.waiting import until

MANY = 50
"""More than asyncio has threads."""


class Work:
    """Waits in many threads until it ends; a `Mock` loses count of calls made at once."""

    def __init__(self) -> None:
        self.ends = threading.Event()
        self.calls: list[object] = []

    def __call__(self, *given: object, **options: object) -> Mock:
        self.calls.append(given)
        self.ends.wait(30)
        return Mock()


@pytest.mark.parametrize(
    ("part", "method", "call"),
    [
        ("health", "of", lambda curator: curator.health("campus", None, 5)),
        ("maps", "delete", lambda curator: curator.delete_map("campus")),
        ("views", "delete", lambda curator: curator.delete_view("view")),
        ("calls", "begin", lambda curator: curator.begin_call("key", "print")),
        ("snapshots", "restore", lambda curator: curator.restore(Mock(), None, Mock())),
        ("proposals", "of", lambda curator: curator.proposals("campus", 5)),
        ("changes", "between", lambda curator: curator.changes("one", "other")),
        ("renderings", "segmentation", lambda curator: curator.segmentation("view", True, False)),
        ("renderings", "graph", lambda curator: curator.graph("view", False)),
    ],
)
def test_an_image_is_shown_while_many_wait_for_what_takes_long(
    part: str, method: str, call: Callable[[Curator], Awaitable[object]]
) -> None:
    work = Work()
    parts = Mock()
    setattr(getattr(parts, part), method, work)
    parts.renderings.image.return_value = b"image", "image/png"
    curator = Curator(parts, parts.calls)

    async def meanwhile() -> tuple[bytes, str]:
        waiting = [asyncio.ensure_future(call(curator)) for _ in range(MANY)]
        try:
            return await asyncio.wait_for(curator.image("view"), 10)
        finally:
            work.ends.set()
            await asyncio.gather(*waiting, return_exceptions=True)

    assert asyncio.run(meanwhile()) == (b"image", "image/png")
    assert len(work.calls) == MANY


DRAWINGS = [
    ("renderings", "graph", lambda curator: curator.graph("view", False)),
    ("renderings", "segmentation", lambda curator: curator.segmentation("view", True, False)),
    ("renderings", "explanation", lambda curator: curator.explanation("query", None)),
    ("changes", "between", lambda curator: curator.changes("one", "other")),
    ("changes", "draw_between", lambda curator: curator.draw_changes("one", "other")),
    ("changes", "of_query", lambda curator: curator.changes_of_query("query")),
    ("changes", "draw_query", lambda curator: curator.draw_changes_of_query("query")),
]


@pytest.mark.parametrize(("part", "method", "draw"), DRAWINGS)
def test_other_long_work_is_done_while_many_wait_for_drawings(
    part: str, method: str, draw: Callable[[Curator], Awaitable[object]]
) -> None:
    """Those that wait for their turn hold none of the threads in which long work is done, and no photos."""
    work = Work()
    parts = Mock()
    setattr(getattr(parts, part), method, work)
    curator = Curator(parts, parts.calls)

    async def meanwhile() -> tuple[object, int]:
        waiting = [asyncio.ensure_future(draw(curator)) for _ in range(MANY)]
        try:
            await asyncio.to_thread(until, lambda: len(work.calls) == DRAWN_AT_ONCE)
            await asyncio.sleep(0.05)  # in which more would be begun
            return await asyncio.wait_for(curator._long.run(lambda: "done"), 10), len(work.calls)
        finally:
            work.ends.set()
            await asyncio.gather(*waiting, return_exceptions=True)

    assert asyncio.run(meanwhile()) == ("done", DRAWN_AT_ONCE)
    assert len(work.calls) == MANY


def test_a_list_is_given_while_many_enrolments_wait_for_the_store() -> None:
    ends = threading.Event()
    recogniser = Recogniser(Mock(submit=lambda *_, **__: ends.wait(30)), Mock(), Mock(), 1, 30.0)

    async def meanwhile() -> str:
        waiting = [
            asyncio.ensure_future(
                recogniser.enroll([(None, b"image")], "campus", ViewAttributes(), False, refuse_poor=None)
            )
            for _ in range(MANY)
        ]
        await asyncio.sleep(0)
        try:
            return await asyncio.wait_for(asyncio.to_thread(lambda: "listed"), 10)
        finally:
            ends.set()
            await asyncio.gather(*waiting, return_exceptions=True)

    assert asyncio.run(meanwhile()) == "listed"


def test_thousands_of_maps_are_told_while_others_are_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    """All of an answer that grows with the maps is made beside the loop that answers everybody."""
    told_in = []

    def told(name: str) -> wire.MapFacts:
        told_in.append(threading.get_ident())
        return wire.MapFacts.model_validate(answers.map_facts(name))

    monkeypatch.setattr("app.http.presenters.map_facts", told)
    parts = Mock()
    parts.maps.all.return_value = ["attic", "campus"]
    listed = asyncio.run(Curator(parts, parts.calls).maps())
    assert [facts["name"] for facts in json.loads(listed)["maps"]] == ["attic", "campus"]
    assert len(told_in) == 2
    assert threading.get_ident() not in told_in
