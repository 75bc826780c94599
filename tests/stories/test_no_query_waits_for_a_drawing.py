"""Large photos take seconds to draw over and to write as PNG; a robot's query does not wait for that."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from schemas.records import ViewAttributes
from schemas.settings import Settings
from tests.sample_images import drawn, encoded
from tests.waiting import PATIENCE_S
from worker.images import drawing
from worker.runtime import Runtime, build

pytestmark = pytest.mark.one_database("it is about what is drawn")

PHOTO = encoded(drawn(320, 240, 0), "jpeg")


@pytest.fixture(scope="module")
def runtime(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Runtime]:
    data: Path = tmp_path_factory.mktemp("data")
    built = build(Settings(data=data, encoder="color", threads=1))
    built.start()
    yield built
    built.stop()


@pytest.fixture(scope="module")
def view(runtime: Runtime) -> str:
    return runtime.services.enroll.enroll(PHOTO, "town", ViewAttributes(place="hall"), patience_s=60).view.id


@pytest.mark.parametrize(
    ("slow", "draw"),
    [
        ("segmentation_png", lambda runtime, view: runtime.services.renderings.segmentation(view, overlay=False)),
        ("overlay_png", lambda runtime, view: runtime.services.renderings.segmentation(view, overlay=True)),
        ("graph_png", lambda runtime, view: runtime.services.renderings.graph(view)),
    ],
)
def test_a_query_is_answered_while_something_is_drawn(
    runtime: Runtime,
    view: str,
    slow: str,
    draw: Callable[[Runtime, str], bytes],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def held(*_: Any, **__: Any) -> bytes:
        begun.set()
        assert go_on.wait(2 * PATIENCE_S)
        return b"drawn"

    monkeypatch.setattr(drawing, slow, held)
    with ThreadPoolExecutor(2) as threads:
        try:
            png = threads.submit(draw, runtime, view)
            assert begun.wait(PATIENCE_S)
            answer = threads.submit(runtime.services.query.query, PHOTO, "town").result(PATIENCE_S)

            assert answer.results.views[0].view.id == view
            assert not png.done()
        finally:
            go_on.set()
        assert png.result(PATIENCE_S) == b"drawn"


def test_what_goes_wrong_while_drawing_reaches_the_caller_and_nobody_else(
    runtime: Runtime, view: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: Any, **__: Any) -> bytes:
        raise MemoryError("no room")

    with monkeypatch.context() as patch:
        patch.setattr(drawing, "graph_png", broken)
        with pytest.raises(MemoryError, match="no room"):
            runtime.services.renderings.graph(view)

    assert runtime.services.renderings.graph(view).startswith(b"\x89PNG")
