"""People are shown the finest labels that the encoder has; what is stored is made of its ordinary field."""

import io
from pathlib import Path

import numpy as np
from PIL import Image as PilImage

from app.http.application import create_app
from schemas.description import SEMANTIC, PixelField
from schemas.image import Image
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.sample_images import drawn, encoded
from worker.description.ports import Encoder, Segmenter
from worker.encoders.color import ColorEncoder
from worker.runtime import build


class StripesOfSkyAndRoad:
    """Every other column of the picture's own pixels is sky, the others are road."""

    def __init__(self, encoder: ColorEncoder) -> None:
        self._text = encoder.text_vectors(["sky", "road"])

    def segment(self, image: Image) -> PixelField:
        sky, road = self._text
        columns = np.where(np.arange(image.width)[:, None] % 2 == 0, sky, road)
        return PixelField({SEMANTIC: np.broadcast_to(columns, (image.height, *columns.shape))}, image.extent)


def with_stripes(settings: Settings, threads: int) -> tuple[Encoder, Segmenter | None]:
    encoder = ColorEncoder()
    return encoder, StripesOfSkyAndRoad(encoder)


def test_a_segmentation_is_drawn_from_the_segmenters_field_and_nothing_else_is(tmp_path: Path) -> None:
    plain = build(Settings(data=tmp_path / "plain", encoder="color", threads=1))
    striped = build(Settings(data=tmp_path / "striped", encoder="color", threads=1), make_encoder=with_stripes)
    photo = {"content": encoded(drawn(320, 240, 0), "jpeg"), "headers": {"content-type": "image/jpeg"}}
    with CheckedClient(create_app(plain)) as client:
        view = client.post("/enroll", **photo).json()["view"]
        description, links = view["description"], view["links"]
        graph, overlay = client.get(links["graph"]).content, client.get(f"{links['segmentation']}?overlay=true").content
    with CheckedClient(create_app(striped)) as client:
        view = client.post("/enroll", **photo).json()["view"]
        links = view["links"]

        labels = np.asarray(PilImage.open(io.BytesIO(client.get(links["segmentation"]).content)))
        names = client.get("/maps/default").json()["recipe"]["labels"]

        assert labels.shape == (240, 320)
        assert [names[label] for label in labels[17, :4]] == ["sky", "road", "sky", "road"]
        assert (labels == labels[0]).all()
        assert client.get(f"{links['segmentation']}?overlay=true").content != overlay
        assert client.get(links["graph"]).content == graph
        assert view["description"] == description
