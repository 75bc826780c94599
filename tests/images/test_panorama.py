"""Views of a panorama: each looks where it should, upright, and nothing is torn where the edges meet."""

from functools import partial

import numpy as np
import pytest

from schemas.records import ViewAttributes
from tests.sample_images import drawn, encoded
from worker.images.codec import Limits, decode
from worker.images.panorama import DIRECTIONS, perspective, turns, views
from worker.service.panoramas import Panoramas
from worker.service.recordings import Item

COLUMNS, ROWS = 1024, 512


def directions() -> np.ndarray:
    """A panorama whose red is the heading from its middle (0..255 for 0..360) and whose green is the height."""
    heading = (np.arange(COLUMNS) + 0.5) / COLUMNS * 256 - 128
    panorama = np.zeros((ROWS, COLUMNS, 3), np.uint8)
    panorama[..., 0] = np.round(heading) % 256
    panorama[..., 1] = np.linspace(255, 0, ROWS)[:, None]
    return panorama


@pytest.mark.parametrize("turn", turns())
def test_the_middle_of_a_view_is_its_direction_and_up_is_up(turn: float) -> None:
    view = perspective(directions(), turn + 10)  # beside the jump of red from 255 to 0
    height, width = view.shape[:2]

    assert (width, height) == (256, 192)
    assert view[height // 2, width // 2, 0] == pytest.approx((turn + 10) / 360 * 256, abs=2)
    assert view[0, width // 2, 1] > 127 > view[-1, width // 2, 1]
    assert view[height // 2, width // 2, 1] == pytest.approx(127, abs=3)


def test_a_view_is_ninety_degrees_wide() -> None:
    view = perspective(directions(), 90)
    row = view[view.shape[0] // 2, :, 0].astype(float) / 256 * 360

    assert (row[0], row[-1]) == (pytest.approx(45, abs=2), pytest.approx(135, abs=2))
    assert np.all(np.diff(row) >= 0)


def test_where_the_edges_meet_nothing_is_torn() -> None:
    smooth = np.asarray(np.cos(np.linspace(0, 2 * np.pi, COLUMNS, endpoint=False)) * 100 + 128, np.uint8)
    panorama = np.repeat(np.repeat(smooth[None, :, None], ROWS, axis=0), 3, axis=2)

    across = perspective(panorama, 180)[96, :, 0].astype(int)

    assert np.abs(np.diff(across)).max() <= 3


def test_neighbours_share_half_of_what_they_see_and_the_bytes_are_always_the_same() -> None:
    panorama = drawn(COLUMNS, ROWS, 5)
    first, again = views(panorama), views(panorama)

    assert len(first) == DIRECTIONS
    assert first == again
    assert len(set(first)) == DIRECTIONS
    assert decode(first[0], Limits()).width == 256


@pytest.mark.parametrize("shape", [(480, 640), (512, 512), (100, 1000)])
def test_what_is_no_panorama_is_refused(shape: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="twice as wide as high"):
        views(np.zeros((*shape, 3), np.uint8))


def test_two_panoramas_of_one_name_have_views_of_their_own() -> None:
    """Images of a ROS 2 recording are named by their time in milliseconds, and a driver may repeat a stamp."""
    spheres = {n: encoded(drawn(256, 128, n), "png") for n in range(2)}
    items = [Item("/sphere 1767225600.000", ViewAttributes(), partial(spheres.__getitem__, n)) for n in range(2)]

    read = [item.read() for item in Panoramas(lambda data: decode(data, Limits())).split(items)]

    assert read == [view for n in range(2) for view in views(decode(spheres[n], Limits()).pixels)]
