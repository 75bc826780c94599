"""What the EXIF of a photo says of its place, and what it does not say."""

import io
from datetime import UTC, datetime
from typing import Any

import pytest
from PIL import Image as PilImage
from PIL.TiffImagePlugin import IFDRational

from tests.sample_images import drawn, encoded
from worker.images.exif import read_exif


def photo(gps: dict[int, Any]) -> io.BytesIO:
    exif = PilImage.Exif()
    exif.get_ifd(0x8825).update(gps)
    return io.BytesIO(encoded(drawn(64, 48, 1), "jpeg", exif=exif))


SOUTH, EAST = (33.0, 51.0, 36.0), (151.0, 12.0, 36.0)


@pytest.mark.parametrize("south", ["S", "s", b"S", b"S\0", "South"])
def test_the_side_is_read_however_it_is_written(south: str | bytes) -> None:
    assert read_exif(photo({1: south, 2: SOUTH, 3: "E", 4: EAST})) == pytest.approx({"lat": -33.86, "lon": 151.21})


@pytest.mark.parametrize("sides", [{}, {1: "S"}, {3: "E"}, {1: "", 3: "E"}, {1: "X", 3: "E"}, {1: "E", 3: "S"}])
def test_degrees_without_a_side_are_no_place(sides: dict[int, str]) -> None:
    """A hemisphere is not guessed: the view would lie elsewhere on the globe."""
    assert read_exif(photo({2: SOUTH, 4: EAST, **sides})) == {}


@pytest.mark.parametrize(
    "clock", ["0001:01:01 00:00:00+14:00", "9999:12:31 23:59:59-12:00", "    :  :     :  :  +00:00"]
)
def test_a_clock_that_was_never_set_tells_no_time(clock: str) -> None:
    exif = PilImage.Exif()
    exif.get_ifd(0x8769).update({0x9003: clock[:-6], 0x9011: clock[-6:]})
    assert read_exif(io.BytesIO(encoded(drawn(64, 48, 1), "jpeg", exif=exif))) == {}


def test_a_height_beyond_what_a_position_may_be_is_none() -> None:
    """4,294,967,295 m, of a receiver that writes -1 where it knows no height."""
    unknown = IFDRational(2**32 - 1, 1)
    known = read_exif(photo({1: "S", 2: SOUTH, 3: "E", 4: EAST, 5: b"\0", 6: unknown}))
    assert known == pytest.approx({"lat": -33.86, "lon": 151.21})


@pytest.mark.parametrize(
    "gps",
    [
        {29: "2026-05-04", 7: (9.0, 30.0, 0.0)},
        {29: "2026:05:04", 7: (9.0, 30.0, 60.0)},
        {29: "2026:05:04", 7: IFDRational(0, 0)},
        {29: "0000:00:00", 7: (0.0, 0.0, 0.0)},
    ],
)
def test_a_time_of_gps_that_is_none_leaves_that_of_the_camera(gps: dict[int, Any]) -> None:
    exif = PilImage.Exif()
    exif.get_ifd(0x8825).update(gps)
    exif.get_ifd(0x8769).update({0x9003: "2026:05:04 11:30:00", 0x9011: "+02:00"})
    known = read_exif(io.BytesIO(encoded(drawn(64, 48, 1), "jpeg", exif=exif)))
    assert known == {"captured_at": datetime(2026, 5, 4, 9, 30, tzinfo=UTC)}


@pytest.mark.parametrize(("reference", "sign"), [(b"\0", 1), (b"\1", -1), (b"\2", 1), (b"\3", -1)])
def test_heights_below_are_below_by_any_reference(reference: bytes, sign: int) -> None:
    known = read_exif(photo({1: "N", 2: SOUTH, 3: "E", 4: EAST, 5: reference, 6: 12.5}))
    assert known["alt"] == sign * 12.5


@pytest.mark.parametrize("magnetic", ["M", "m", b"M", "M "])
def test_a_magnetic_direction_is_no_heading_however_it_is_written(magnetic: str | bytes) -> None:
    assert read_exif(photo({16: magnetic, 17: 90.0})) == {}
    assert read_exif(photo({16: "T", 17: 90.0})) == {"heading": 90}


@pytest.mark.parametrize(
    ("digits", "microseconds"),
    [("2", 200_000), ("04 ", 40_000), ("1234567", 123_456), (b"25\0", 250_000), ("  ", 0), ("-5", 0), (None, 0)],
)
def test_images_of_one_second_are_told_apart_by_its_fractions(digits: str | bytes | None, microseconds: int) -> None:
    exif = PilImage.Exif()
    exif.get_ifd(0x8769).update({0x9003: "2026:05:04 11:30:00", 0x9011: "+02:00"})
    if digits is not None:
        exif.get_ifd(0x8769)[0x9291] = digits
    known = read_exif(io.BytesIO(encoded(drawn(64, 48, 1), "jpeg", exif=exif)))
    assert known == {"captured_at": datetime(2026, 5, 4, 9, 30, 0, microseconds, tzinfo=UTC)}


def test_a_time_of_gps_has_its_fractions() -> None:
    known = read_exif(photo({29: "2026:05:04", 7: (9.0, 30.0, IFDRational(1234, 100))}))
    assert known == {"captured_at": datetime(2026, 5, 4, 9, 30, 12, 340_000, tzinfo=UTC)}
