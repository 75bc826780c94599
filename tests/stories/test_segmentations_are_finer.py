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
from worker.description.ports import Encoder, Segmenter
from worker.encoders.choosing import make_encoder
from worker.encoders.color import ColorEncoder
from worker.runtime import build

pytestmark = pytest.mark.one_database("it is about what is drawn")


class StripesOfSkyAndRoad:
    """Every other column of the picture's own pixels is sky, the others are road."""

    def __init__(self, encoder: ColorEncoder) -> None:
        self._text = encoder.text_vectors(["sky", "road"])

    def segment(self, image: Image, *, urgent: bool = False) -> PixelField:
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
        assert client.get(links["segmentation"]).headers["revisit-drawn-by"] == "encoder"
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
        networks = [client.get(links[kind]).headers["revisit-drawn-by"] for kind in ("segmentation", "graph")]
        assert networks == ["segmenter", "encoder"]


def test_drawings_are_as_large_as_the_photo_and_say_below_which_network_they_are_of(tmp_path: Path) -> None:
    photo = {"content": encoded(drawn(320, 240, 0), "jpeg"), "headers": {"content-type": "image/jpeg"}}
    heights: dict[str, list[int]] = {}
    for make in (make_encoder, with_stripes):
        runtime = build(Settings(data=tmp_path / make.__name__, encoder="color", threads=1), make_encoder=make)
        with CheckedClient(create_app(runtime)) as client:
            links = client.post("/enroll", **photo).json()["view"]["links"]
            for drawing in (f"{links['segmentation']}?overlay=true", links["graph"]):
                assert PilImage.open(io.BytesIO(client.get(drawing).content)).size == (320, 240)
                keyed = client.get(f"{drawing}{'&' if '?' in drawing else '?'}legend=true").content
                heights.setdefault(make.__name__, []).append(PilImage.open(io.BytesIO(keyed)).height)
    assert all(height > 240 for height in heights["make_encoder"])
    # Only where two networks are at work does a caption tell them apart.
    assert heights["with_stripes"][1] > heights["make_encoder"][1]
