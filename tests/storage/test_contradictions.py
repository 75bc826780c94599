"""Which times, said of an image that is enrolled already, are other than those that are kept."""

from datetime import datetime, timedelta

import pytest

from schemas.records import ViewAttributes
from tests.storage.material import NOW
from worker.storage.enrolment import contradictions

EXACT = NOW + timedelta(milliseconds=250)


def of_times(kept: datetime | None, anew: datetime | None) -> list[str]:
    return contradictions(ViewAttributes(captured_at=kept), ViewAttributes(captured_at=anew))


@pytest.mark.parametrize(("kept", "anew"), [(NOW, NOW), (EXACT, EXACT), (NOW, EXACT), (EXACT, None), (None, None)])
def test_a_time_said_to_more_than_the_second_that_is_kept_is_the_same(
    kept: datetime | None, anew: datetime | None
) -> None:
    """EXIF was read in whole seconds before, and such recordings are sent again."""
    assert of_times(kept, anew) == []


@pytest.mark.parametrize(
    ("kept", "anew"),
    [(None, NOW), (EXACT, NOW), (NOW, EXACT + timedelta(seconds=1)), (EXACT, EXACT + timedelta(milliseconds=1))],
)
def test_any_other_time_is_another(kept: datetime | None, anew: datetime) -> None:
    assert of_times(kept, anew) == ["captured_at"]
