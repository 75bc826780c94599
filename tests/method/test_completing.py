"""What EXIF adds to what a manifest or a caller says."""

from datetime import UTC, datetime

import pytest

from schemas.records import Position, ViewAttributes
from worker.service.completing import completed

EXIF = {"lat": 50.5, "lon": 14.0, "alt": 200.0, "heading": 90.0, "captured_at": datetime(2026, 5, 4, tzinfo=UTC)}


@pytest.mark.parametrize(
    ("given", "completes"),
    [
        (Position(), Position(lat=50.5, lon=14.0, alt=200.0, heading=90.0)),
        (Position(heading=0.0), Position(lat=50.5, lon=14.0, alt=200.0, heading=0.0)),
        (Position(lat=1.0, lon=2.0), Position(lat=1.0, lon=2.0)),
        (Position(x=1.0, y=2.0, heading=3.0), Position(x=1.0, y=2.0, heading=3.0)),
    ],
)
def test_a_point_is_taken_as_a_whole_and_a_heading_is_none(given: Position, completes: Position) -> None:
    found = completed(ViewAttributes(position=given), EXIF)
    assert (found.position, found.captured_at) == (completes, EXIF["captured_at"])


def test_where_exif_knows_nothing_what_is_given_stays() -> None:
    given = ViewAttributes(position=Position(heading=5.0))
    assert completed(given, {}) == given
