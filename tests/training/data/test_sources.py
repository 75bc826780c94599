import shutil
from pathlib import Path

from training.data.sources import find_sources


def test_validation_images_are_learned_from_only_when_wanted(data_folder: Path) -> None:
    folder = data_folder / "segmentation" / "camvid"
    for kind in ("images", "labels"):
        (folder / "val" / kind).mkdir(parents=True)
        first = sorted((folder / "train" / kind).glob("*"))[0]
        shutil.copy(first, folder / "val" / kind / first.name)

    usual, more = (
        find_sources(data_folder, None, splits)["camvid"].scenes for splits in (("train",), ("train", "val"))
    )

    assert len(more) == len(usual) + 1
    assert more[-1][0].image.parent == folder / "val" / "images"
    assert more[-1][0].labels is not None
    assert more[-1][0].labels.exists()
