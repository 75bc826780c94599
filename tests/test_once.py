"""What is kept for the other processes of a test run is what they would have made."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenes import scene as seen
from schemas.image import Image
from tests.described_once import describe_once
from tests.once import FOLDER, once
from worker.description.describer import Describer
from worker.description.presets import Wanted, general_vocabulary, make_recipe
from worker.encoders.color import ColorEncoder


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(FOLDER, str(tmp_path))


@pytest.fixture
def describer() -> Describer:
    encoder = ColorEncoder()
    recipe = make_recipe(encoder, Wanted(), preset="default").description
    return Describer(encoder, recipe, general_vocabulary(encoder, "default"))


def described(describer: Describer, image: Image) -> dict[str, Any]:
    [field] = ColorEncoder().encode([image])
    return asdict(describer.describe(image, field, describer.keypoints(image)))


def test_the_description_that_is_kept_is_the_one_that_would_be_made(
    describer: Describer, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    images = [Image.of(seen(place).pixels) for place in ("mill lane", "rose garden")]
    plain = [described(describer, image) for image in images]

    describe_once(monkeypatch.setattr)
    for _ in range(2):  # it is made, and then it is there
        np.testing.assert_equal([described(describer, image) for image in images], plain)
    assert len(list(tmp_path.glob("keypoints-*"))) == len(list(tmp_path.glob("description-*"))) == len(images)


def test_what_fails_is_made_again() -> None:
    def fail() -> None:
        raise ValueError("the first time")

    with pytest.raises(ValueError, match="the first time"):
        once(fail, "number", b"7")
    assert once(lambda: 7, "number", b"7") == 7
    assert once(fail, "number", b"7") == 7
    assert once(lambda: 8, "number", b"8") == 8
