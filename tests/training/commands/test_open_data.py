"""A data folder that anybody may train on."""

from pathlib import Path

import cv2
import numpy as np

from scenes import LABELS
from training.commands.open_data import main
from training.data.lexicon import ClipVectors, Lexicon
from training.data.sources import CLIP_FILE, PHOTOS, find_classes, find_sources, read_training_image


def photo(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((48, 64, 3), 90, np.uint8))


def test_what_it_makes_is_found_by_training(tmp_path: Path, data_folder: Path) -> None:
    free, made = tmp_path / "free", tmp_path / "open"
    for name in ("opensfm/lund/0001.jpg", "pmndrs-hdri/hall/0001.jpg", "by-sa/boofcv-data/tree/0001.jpg"):
        photo(free / name)
    arguments = ["--free", str(free), "--text", str(data_folder / "text"), "--to", str(made)]
    arguments += ["--labelled", "5", "--aligned", "1"]

    main(arguments)

    sources = find_sources(made, None)
    counts = {name: len(source.scenes) for name, source in sources.items()}
    assert counts == {"drawn": 5, PHOTOS: 1, "indoor": 1, "aligned": 1}
    assert [shot.image.name for scene in sources[PHOTOS].scenes for shot in scene] == ["opensfm-lund-0001.jpg"]
    assert len(sources["aligned"].scenes[0]) == 4  # lights
    lexicon = Lexicon(ClipVectors(made / CLIP_FILE), find_classes(made))
    assert {"road", "wall", "floor", "ceiling"} <= set(lexicon.labels)
    for [shot] in sources["drawn"].scenes:
        assert shot.labels is not None
        labels = cv2.imread(str(shot.labels), cv2.IMREAD_UNCHANGED)
        assert labels.shape == read_training_image(shot.image).shape[:2]
        assert labels.max() < len(LABELS)


def test_a_run_that_was_stopped_goes_on(tmp_path: Path, data_folder: Path) -> None:
    photo(tmp_path / "free" / "opensfm" / "lund" / "0001.jpg")
    arguments = ["--free", str(tmp_path / "free"), "--text", str(data_folder / "text"), "--to", str(tmp_path / "open")]
    main([*arguments, "--labelled", "2", "--aligned", "0"])
    images = tmp_path / "open" / "segmentation" / "drawn" / "train" / "images"
    before = {path.name: path.stat().st_mtime_ns for path in images.iterdir()}

    main([*arguments, "--labelled", "3", "--aligned", "0"])

    after = {path.name: path.stat().st_mtime_ns for path in images.iterdir()}
    assert before.items() <= after.items()
    assert sorted(after) == ["00000.jpg", "00001.jpg", "00002.jpg"]
