"""People are shown the finest labels that the encoder has; what is stored is made of its ordinary field."""

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as PilImage

from app.http.application import create_app
from schemas.description import SEMANTIC, PixelField
from schemas.image import Image
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.sample_images import drawn, encoded
from worker.bootstrap import build
from worker.encoders.color import ColorEncoder


def stripes_of_sky_and_road(encoder: ColorEncoder, image: Image) -> PixelField:
    """Every other column of the picture's own pixels is sky, the others are road."""
    sky, road = encoder.text_vectors(["sky", "road"])
    columns = np.where(np.arange(image.width)[:, None] % 2 == 0, sky, road)
    return PixelField({SEMANTIC: np.broadcast_to(columns, (image.height, *columns.shape))}, image.extent)


def test_a_segmentation_is_drawn_from_the_fine_field_and_nothing_else_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runtime = build(Settings(data=tmp_path, encoder="color", threads=1))
    photo = encoded(drawn(320, 240, 0), "jpeg")
    with CheckedClient(create_app(runtime)) as client:
        links = client.post("/enroll", content=photo, headers={"content-type": "image/jpeg"}).json()["view"]["links"]
        graph, overlay = client.get(links["graph"]).content, client.get(f"{links['segmentation']}?overlay=true").content
        monkeypatch.setattr(ColorEncoder, "fine", stripes_of_sky_and_road)

        labels = np.asarray(PilImage.open(io.BytesIO(client.get(links["segmentation"]).content)))
        words = client.get("/maps/default").json()["recipe"]["labels"]

        assert labels.shape == (240, 320)
        assert [words[label] for label in labels[17, :4]] == ["sky", "road", "sky", "road"]
        assert (labels == labels[0]).all()
        assert client.get(f"{links['segmentation']}?overlay=true").content != overlay
        assert client.get(links["graph"]).content == graph
