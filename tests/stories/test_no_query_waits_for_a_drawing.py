"""Segmentations take as long as a dozen queries, and large photos seconds to draw over; no query waits for that."""

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from scenes import scene
from schemas.description import PixelField
from schemas.image import Image
from schemas.records import ViewAttributes
from schemas.settings import Settings
from tests.sample_images import drawn, encoded
from tests.waiting import PATIENCE_S
from worker.description.presets import Wanted
from worker.encoders.color import ColorEncoder
from worker.images import drawing
from worker.runtime import Runtime, build
from worker.runtime.services import Services

pytestmark = pytest.mark.one_database("it is about what is drawn")

HALL = [encoded(scene("hall").pixels, form) for form in ("png", "jpeg")]
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


class HeldSegmenter:
    """Segments once the test lets it."""

    def __init__(self) -> None:
        self.begun, self.go_on = threading.Event(), threading.Event()

    def segment(self, image: Image, *, urgent: bool = False) -> PixelField:
        self.begun.set()
        assert self.go_on.wait(2 * PATIENCE_S)
        return next(ColorEncoder().encode([image]))


@pytest.mark.parametrize(
    "ask",
    [
        lambda services, view, _: services.renderings.segmentation(view, overlay=False),
        lambda services, *_: services.enroll.enroll(HALL[0], "shop", ViewAttributes(), patience_s=PATIENCE_S),
        lambda services, view, earlier: services.changes.between(view, earlier),
    ],
    ids=["a drawing", "a photo that is blurred", "a comparison"],
)
def test_a_query_is_answered_while_something_is_segmented(
    tmp_path: Path, ask: Callable[[Services, str, str], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    segmenter = HeldSegmenter()
    settings = Settings(data=tmp_path, encoder="color", threads=1)
    runtime = build(settings, make_encoder=lambda *_: (ColorEncoder(), segmenter))
    services = runtime.services
    with ExitStack() as stack:
        runtime.start()
        stack.callback(runtime.stop)
        services.maps.put("shop", Wanted())
        services.maps.change("shop", blur=["car"])
        earlier, view = (
            services.enroll.enroll(photo, "town", ViewAttributes(place="hall"), patience_s=PATIENCE_S).view.id
            for photo in HALL
        )
        threads = stack.enter_context(ThreadPoolExecutor(2))
        stack.callback(segmenter.go_on.set)
        slow_one = threads.submit(ask, services, view, earlier)
        assert segmenter.begun.wait(PATIENCE_S)
        answer = threads.submit(services.query.query, HALL[1], "town").result(PATIENCE_S)

        assert view in [match.view.id for match in answer.results.views]
        assert not slow_one.done()
        assert runtime.beyond_help is None
        monkeypatch.setattr("worker.description.scheduler.HANGS_S", 0.0)
        assert (runtime.beyond_help or "").startswith("the segmenter has been at one image for ")
        segmenter.go_on.set()
        assert slow_one.result(PATIENCE_S)


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
