"""What the EXIF of a photo says of its place, and what it does not say."""

import io
from typing import Any

import pytest
from PIL import Image as PilImage

from tests.sample_images import drawn, encoded
from worker.images.exif import taken


def photo(gps: dict[int, Any]) -> io.BytesIO:
    exif = PilImage.Exif()
    exif.get_ifd(0x8825).update(gps)
    return io.BytesIO(encoded(drawn(64, 48, 1), "jpeg", exif=exif))


SOUTH, EAST = (33.0, 51.0, 36.0), (151.0, 12.0, 36.0)


@pytest.mark.parametrize("south", ["S", "s", b"S", b"S\0", "South"])
def test_the_side_is_read_however_it_is_written(south: str | bytes) -> None:
    assert taken(photo({1: south, 2: SOUTH, 3: "E", 4: EAST})) == pytest.approx({"lat": -33.86, "lon": 151.21})


@pytest.mark.parametrize("sides", [{}, {1: "S"}, {3: "E"}, {1: "", 3: "E"}, {1: "X", 3: "E"}, {1: "E", 3: "S"}])
def test_degrees_without_a_side_are_no_place(sides: dict[int, str]) -> None:
    """A hemisphere is not guessed: the view would lie elsewhere on the globe."""
    assert taken(photo({2: SOUTH, 4: EAST, **sides})) == {}
