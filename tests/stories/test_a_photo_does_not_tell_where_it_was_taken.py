"""A photo that is served back has lost its position, and what was hidden behind it; the place is found all the same."""

import io
from pathlib import Path

import httpx
import numpy as np
import pytest
from PIL import Image as PilImage

from app.http.application import create_app
from lab.faults.heics import heics
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.sample_images import drawn, encoded
from tests.stories.running import RunningService
from worker.images import stripping
from worker.runtime import build

pytestmark = pytest.mark.one_database("images lie in a folder, whatever the database is")

SECRET = b"<script>of my garden</script>"


def test_position_and_polyglot_are_gone_and_the_view_is_found(tmp_path: Path) -> None:
    exif = PilImage.Exif()
    exif[0x0112] = 6
    exif.get_ifd(0x8825)[1] = "N"
    exif[0x010E] = "of my garden"
    sent = encoded(drawn(96, 64), "jpeg", exif=exif) + SECRET
    jpeg = {"content-type": "image/jpeg"}
    runtime = build(Settings(data=tmp_path, encoder="color", threads=1, compare=False))
    with CheckedClient(create_app(runtime)) as client:
        view = client.post("/enroll?map=m", content=sent, headers=jpeg).json()["view"]["id"]
        served = client.get(f"/views/{view}/image")
        assert served.status_code == 200
        assert b"garden" not in served.content
        assert runtime.store.views.image(view) == sent
        answer = client.post("/query?map=m", content=served.content, headers=jpeg).json()
    assert answer["matches"][0]["view"]["id"] == view
    assert answer["query"]["width"] == 64


@pytest.mark.parametrize("form", ["tiff", "bmp"])
def test_an_image_that_another_copy_would_change_is_given_as_png(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Decoders guess where a damaged TIFF or BMP has its pixels: without its metadata it may show something else."""
    pixels = drawn(96, 64)
    other = encoded(drawn(96, 64, 1), form)
    monkeypatch.setattr(stripping, "strip", lambda data, kind: other)
    runtime = build(Settings(data=tmp_path, encoder="color", threads=1, compare=False))
    with CheckedClient(create_app(runtime)) as client:
        sent = client.post("/enroll?map=m", content=encoded(pixels, form), headers={"content-type": f"image/{form}"})
        served = client.get(f"/views/{sent.json()['view']['id']}/image")
    assert served.headers["content-type"] == "image/png"
    assert np.array_equal(np.asarray(PilImage.open(io.BytesIO(served.content))), np.asarray(pixels))


def test_of_a_photo_in_heic_a_jpeg_is_given_back(tmp_path: Path) -> None:
    with RunningService(tmp_path) as service, httpx.Client(base_url=service.url, timeout=60) as client:
        for name, data in heics().items():
            sent = client.post(f"/enroll?place={name}", content=data, headers={"content-type": "image/heic"})
            assert sent.status_code == 201, sent.text
            assert sent.json()["view"]["image"]["format"] == "heic"
        answer = client.post("/query", files={"image": ("IMG_1.HEIC", heics()["turned"])}).json()
        view = answer["matches"][0]["view"]
        shown = client.get(view["links"]["image"])

    assert view["place"] == "turned"
    assert shown.headers["content-type"] == "image/jpeg"
    with PilImage.open(io.BytesIO(shown.content)) as jpeg:
        assert (jpeg.size, dict(jpeg.getexif())) == ((64, 96), {})
