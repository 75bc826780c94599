from pathlib import Path

import cv2
import numpy as np

from training.data.crops import COUNT, WHOLE, Crop, crops_of, images_to_distil

ROOT = Path("/data")


def test_crops_depend_on_the_path_alone_and_begin_with_the_whole() -> None:
    one = crops_of(ROOT / "unlabelled/walk/1.jpg", ROOT, (300, 400))

    assert one == crops_of(ROOT / "unlabelled/walk/1.jpg", ROOT, (300, 400))
    assert one != crops_of(ROOT / "unlabelled/walk/2.jpg", ROOT, (300, 400))
    assert one[0] == WHOLE
    assert len(one) == COUNT
    for crop in one:
        assert 0 <= crop.left <= crop.left + crop.width <= 1 + 1e-9
        assert 0 <= crop.top <= crop.top + crop.height <= 1 + 1e-9


def test_the_shots_of_an_aligned_scene_have_the_same_crops() -> None:
    day, night = (crops_of(ROOT / f"pairs/aligned/webcam/square/{n}.jpg", ROOT, (300, 400)) for n in (0, 1))
    assert day == night


def test_of_a_tiny_image_only_the_whole_is_seen() -> None:
    assert crops_of(ROOT / "unlabelled/walk/1.jpg", ROOT, (97, 97)) == [WHOLE]


def test_a_crop_is_cut_where_it_says() -> None:
    image = np.zeros((100, 200, 3), np.uint8)
    image[50:, 100:] = 255

    assert Crop(0.5, 0.5, 0.5, 0.5).cut(image, 32).min() == 255
    assert Crop(0.0, 0.0, 0.5, 0.5).cut(image, 32).max() == 0


def test_no_image_by_which_networks_are_judged_is_looked_at(data_folder: Path) -> None:
    for folder in ("places/campus/query", "pairs/same_place/park/1", "segmentation/camvid/test/images"):
        (data_folder / folder).mkdir(parents=True)
        cv2.imwrite(str(data_folder / folder / "0.jpg"), np.zeros((64, 64, 3), np.uint8))

    found = {path.relative_to(data_folder).parts[0:2] for path in images_to_distil(data_folder)}

    assert found == {("segmentation", "camvid"), ("unlabelled", "indoor"), ("pairs", "aligned")}
    assert not any("test" in path.parts for path in images_to_distil(data_folder))
