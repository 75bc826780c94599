"""What is fixed to a camera is the same in all of its views: it makes no two of them duplicates."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.http.application import create_app
from scenes import scene
from scenes.geometry import Pixels
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.stories.photos import jpeg
from tests.stories.test_a_robot_sees_its_own_bonnet import PLACES
from worker.runtime import build

pytestmark = pytest.mark.one_database("tests/search holds that both kinds of index draw the same sample")

JPEG = {"content-type": "image/jpeg"}


def fisheye(pixels: Pixels) -> Pixels:
    """A circle of the image, as high as it is, within a black border."""
    height, width = pixels.shape[:2]
    down, right = np.mgrid[:height, :width]
    within = (down - height / 2) ** 2 + (right - width / 2) ** 2 <= (height / 2) ** 2
    return np.where(within[..., None], pixels, np.uint8(0))


def test_a_frame_further_on_is_enrolled_without_a_warning_and_the_same_one_is_not(tmp_path: Path) -> None:
    runtime = build(Settings(data=tmp_path, encoder="compact", threads=1, compare=False))
    with CheckedClient(create_app(runtime)) as client:

        def warned_of(image: bytes) -> list[Any]:
            answer = client.post("/enroll?map=walk", content=image, headers=JPEG).raise_for_status().json()
            return [warning["code"] for warning in answer["warnings"]]

        assert [warned_of(jpeg(fisheye(scene(name).pixels))) for name in PLACES] == [[]] * len(PLACES)
        further_on = scene(PLACES[0]).seen_from(dx=0.3, ahead=0.15)
        assert warned_of(jpeg(fisheye(further_on.pixels))) == []
        counts = client.get("/maps/walk/health").json()["counts"]
        assert counts["duplicates"] == 0

        again = warned_of(jpeg(fisheye(scene(PLACES[0]).pixels), quality=60))
        assert again == ["duplicate"]
        assert client.get("/maps/walk/health").json()["counts"]["duplicates"] == 1
