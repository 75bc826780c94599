"""What takes long keeps nobody else from a thread."""

import asyncio
import threading
from collections.abc import Awaitable, Callable
from unittest.mock import Mock

import pytest

from app.http.curate import Curator

PARTS = (
    *("views", "renderings", "maps", "jobs", "calibrations", "health", "inbox", "proposals", "snapshots", "calls"),
    *("imports", "shadows", "changes"),
)
MANY = 50
"""More than asyncio has threads."""


@pytest.mark.parametrize(
    ("part", "method", "call"),
    [
        ("health", "of", lambda curator: curator.health("campus", None, 5)),
        ("maps", "delete", lambda curator: curator.delete_map("campus")),
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
    ends = threading.Event()
    parts = {name: Mock() for name in PARTS}
    getattr(parts[part], method).side_effect = lambda *_, **__: ends.wait(30) and Mock()
    parts["renderings"].image.return_value = b"image", "image/png"
    curator = Curator(**parts)

    async def meanwhile() -> tuple[bytes, str]:
        waiting = [asyncio.ensure_future(call(curator)) for _ in range(MANY)]
        try:
            return await asyncio.wait_for(curator.image("view"), 10)
        finally:
            ends.set()
            await asyncio.gather(*waiting, return_exceptions=True)

    assert asyncio.run(meanwhile()) == (b"image", "image/png")
