"""How many times as large one camera shows things as another, from what is known of both."""

import math

import pytest
from hypothesis import given, strategies as st
from revisit_client import zoom_between

ANGLES = st.floats(0.5, 179.5)


@given(ANGLES, ANGLES, ANGLES)
def test_zooms_from_camera_to_camera_multiply(one: float, other: float, third: float) -> None:
    assert zoom_between(one, one) == 1
    assert math.isclose(zoom_between(one, other) * zoom_between(other, third), zoom_between(one, third), rel_tol=1e-9)
    assert (zoom_between(one, other) > 1) == (one < other and zoom_between(one, other) != 1)


def test_it_is_the_quotient_of_focal_lengths() -> None:
    fx, width = 920.0, 1280
    narrow, wide = (math.degrees(2 * math.atan(width / (2 * focal))) for focal in (fx, fx / 2))
    assert zoom_between(narrow, wide) == pytest.approx(2)


@pytest.mark.parametrize("wrong", [0.0, -70.0, 180.0, math.nan, math.inf])
def test_an_angle_that_no_image_spans_is_refused(wrong: float) -> None:
    for given_to in ((wrong, 70.0), (70.0, wrong)):
        with pytest.raises(ValueError, match="more than 0, less than 180"):
            zoom_between(*given_to)
