import numpy as np

from lab.benchmarks.portraits import side_by_side


def test_images_of_other_heights_stand_beside_each_other_on_white() -> None:
    tall, flat = np.zeros((6, 4, 3), np.uint8), np.full((2, 3, 3), 9, np.uint8)
    both = side_by_side(tall, flat)
    assert both.shape == (6, 7, 3)
    assert (both[:2, 4:] == 9).all()
    assert (both[2:, 4:] == 255).all()
