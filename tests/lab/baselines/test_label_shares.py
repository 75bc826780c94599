"""The label-share histogram, with an encoder drawn by hand."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from lab.baselines.baseline import rank_readable
from lab.baselines.label_shares import LabelShares
from schemas.description import SEMANTIC, Floats, PixelField
from schemas.errors import BadImage
from schemas.image import Image
from schemas.records import Meaning


class RowsOfLabels:
    """The grey level of the one pixel row says what share of the cells is the first label; the rest is the last."""

    name, digest, terms = "rows", "0", "none"
    layers: Mapping[str, int] = {SEMANTIC: 3}
    known_labels: frozenset[str] | None = None

    def encode(self, images: Sequence[Image], *, urgent: bool = False) -> Iterator[PixelField]:
        for image in images:
            sky, cars = (int(v) for v in image.pixels[0, 0, :2])
            which = np.repeat([0, 1, 2], [sky, 10 - sky - cars, cars])
            yield PixelField({SEMANTIC: np.eye(3, dtype=np.float32)[which][None]}, (1.0, 1.0))

    def text_vectors(self, labels: Sequence[str]) -> Floats:
        return np.eye(3, dtype=np.float32)[: len(labels)]

    def meanings(self, labels: Sequence[str]) -> list[Meaning]:
        return [Meaning(label, (label,), True) for label in labels]


def decode(path: Path) -> Image:
    sky, cars = (int(part) for part in path.stem.split("_"))
    return Image.of(np.full((1, 1, 3), (sky, cars, 0), np.uint8))


def test_shares_are_of_what_stays_and_cars_do_not_matter() -> None:
    baseline = LabelShares(RowsOfLabels(), ("sky", "building", "car"), ("car",), decode)
    distances = baseline.rank([Path("8_0"), Path("5_0")], [Path("8_0"), Path("4_5"), Path("0_10")], lambda: None)
    assert distances[0] == pytest.approx([0, np.hypot(0.3, 0.3)], abs=1e-3)
    assert distances[1] == pytest.approx([0, np.hypot(0.3, 0.3)], abs=1e-3)  # 4 of the 5 static cells are sky
    assert distances[2] == pytest.approx([np.hypot(0.8, 0.2), np.hypot(0.5, 0.5)], abs=1e-3)


def test_an_image_that_the_service_alone_refuses_does_not_end_the_ranking(tmp_path: Path) -> None:
    files = [tmp_path / f"{name}.png" for name in ("8_0", "5_0", "wide")]
    for file in files:  # OpenCV reads all of them
        assert cv2.imwrite(str(file), np.zeros((2, 2), np.uint8))

    def refusing(path: Path) -> Image:
        if path.stem == "wide":
            raise BadImage("picture-too-large", "one side is too long")
        return decode(path)

    baseline = LabelShares(RowsOfLabels(), ("sky", "building", "car"), ("car",), refusing)
    distances, unreadable = rank_readable(baseline, files, files[:1], lambda: None)
    assert (int(distances.argmin()), unreadable) == (0, 1)
    assert np.isinf(distances[0]).tolist() == [False, False, True]
