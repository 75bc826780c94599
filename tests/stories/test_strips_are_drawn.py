"""The narrowest images that are taken can be drawn like all others, and narrower ones are refused at the door."""

import io
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as PilImage

from app.http.application import create_app
from schemas.settings import Settings
from tests.openapi import CheckedClient
from worker.images.codec import NARROWEST
from worker.runtime import build

pytestmark = pytest.mark.one_database("it is about what is drawn")

PNG = {"content-type": "image/png"}
SHORTER = 300


def strip(width: int, height: int) -> bytes:
    """A PNG of blocks in two colours, a few kB for any size."""
    blocks = np.indices((height, width)).sum(axis=0, dtype=np.uint16) // 100 % 2
    image = PilImage.fromarray(blocks.astype(np.uint8), mode="P")
    image.putpalette([90, 140, 60, 130, 170, 220])
    buffer = io.BytesIO()
    image.convert("RGB").save(buffer, "PNG", compress_level=1)
    return buffer.getvalue()


@pytest.mark.parametrize("lying", [True, False])
def test_all_that_is_drawn_of_the_narrowest_image_is_answered(tmp_path: Path, lying: bool) -> None:
    size = (NARROWEST * SHORTER, SHORTER) if lying else (SHORTER, NARROWEST * SHORTER)
    runtime = build(Settings(data=tmp_path, encoder="color", threads=1))
    with CheckedClient(create_app(runtime)) as client:
        one, other = (
            client.post("/enroll", content=strip(*shape), headers=PNG).json()["view"]
            for shape in (size, (size[0] - size[0] // 100, size[1] - size[1] // 100))
        )
        answer = client.post("/query?explain=true&changes=true", content=strip(*size), headers=PNG).json()
        links, queried = one["links"], f"/queries/{answer['query']['id']}"
        for address in (
            f"{links['thumbnail']}?size=1024",
            links["segmentation"],
            f"{links['segmentation']}?overlay=true&legend=true",
            f"{links['graph']}?legend=true",
            f"/views/{one['id']}/changes.png?since={other['id']}",
            f"{queried}/explanation.png",
            f"{queried}/changes.png",
        ):
            begin = time.perf_counter()
            found = client.get(address)
            taken_s = time.perf_counter() - begin

            assert found.status_code == 200, (address, found.text)
            assert taken_s < 20, address
            drawn = PilImage.open(io.BytesIO(found.content))
            assert drawn.width * drawn.height < 2 * size[0] * size[1] + 4_000_000, address
            assert len(found.content) < 10_000_000, address


def test_a_narrower_one_is_refused(tmp_path: Path) -> None:
    runtime = build(Settings(data=tmp_path, encoder="color", threads=1))
    with CheckedClient(create_app(runtime)) as client:
        refused = client.post("/enroll", content=strip(400_000, 40), headers=PNG)

        assert (refused.status_code, refused.json()["type"]) == (422, "urn:revisit:problem:picture-too-large")
        assert client.get("/views").json()["views"] == []
