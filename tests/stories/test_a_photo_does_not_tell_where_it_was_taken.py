"""A photo that is served back has lost its position, and what was hidden behind it; the place is found all the same."""

from pathlib import Path

from PIL import Image as PilImage

from app.http.application import create_app
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.sample_images import drawn, encoded
from worker.runtime import build

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
