"""Whether a shared encoder is ready, and alive."""

import re
import time
from collections.abc import Iterator

import pytest

from schemas.description import PixelField
from tests.http.shared_encoder import GatedEncoder, ask, pixels, serving
from tests.waiting import PATIENCE_S, until


def test_it_is_ready_when_it_encodes_and_says_why_not(monkeypatch: pytest.MonkeyPatch) -> None:
    encoder = GatedEncoder()
    monkeypatch.setattr("app.http.encoding.CHECK_S", PATIENCE_S)
    with serving(encoder) as client:
        assert client.get("/readyz").json()["checks"] == {"encoder": "ok"}
        assert encoder.batches == [[127]]
        monkeypatch.setattr("app.http.encoding.CHECK_S", 0.2)
        encoder.open.clear()
        time.sleep(0.25)

        answer = client.get("/readyz")

        assert answer.status_code == 503
        assert re.fullmatch(r"it has encoded no image for \d+ s", answer.json()["checks"]["encoder"])
        assert "retry-after" in answer.headers
        encoder.open.set()
        until(lambda: client.get("/readyz").status_code == 200)


@pytest.mark.parametrize("path", ["/livez", "/v2/health/live"])
def test_one_that_fails_on_every_image_is_to_be_restarted(monkeypatch: pytest.MonkeyPatch, path: str) -> None:
    monkeypatch.setattr("worker.description.scheduler.HOPELESS_S", 0.1)
    with serving(GatedEncoder()) as client, monkeypatch.context() as broken:

        def fail(*_: object, **__: object) -> Iterator[PixelField]:
            raise RuntimeError("the GPU is lost")

        broken.setattr(GatedEncoder, "encode", fail)
        answer = ask(client, pixels(1))
        assert (answer.status_code, answer.json()["type"]) == (503, "urn:revisit:problem:unavailable")
        assert "fails on every image (RuntimeError)" in answer.json()["error"]
        assert "fails on every image" in client.get("/readyz").json()["checks"]["encoder"]

        until(lambda: client.get(path).status_code == 503)  # it tries by itself: nobody sends an image any more
        assert client.get(path).text.startswith("the encoder has failed on every image for ")
        broken.undo()
        until(lambda: client.get(path).text == "ok\n")
