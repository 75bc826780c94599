"""How large the compact network sees an image."""

import pytest

from worker.encoders.compact.input_size import network_size


@pytest.mark.parametrize(
    ("size", "expected"), [((640, 480), (480, 352)), ((480, 640), (352, 480)), ((4000, 90), (480, 96))]
)
def test_sides_become_multiples_of_the_deepest_stride(size: tuple[int, int], expected: tuple[int, int]) -> None:
    assert network_size(*size) == expected


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        ((32, 24), (352, 256)),
        ((97, 97), (352, 352)),
        ((128, 96), (448, 352)),
        ((97, 128), (352, 448)),
        ((144, 80), (480, 256)),
    ],
)
def test_the_smallest_images_are_enlarged_less(size: tuple[int, int], expected: tuple[int, int]) -> None:
    assert network_size(*size) == expected
