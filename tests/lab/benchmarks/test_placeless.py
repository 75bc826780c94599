"""How often one wall is taken for another is counted by kind, on the drawn ones or on anybody's images."""

from pathlib import Path

import cv2
import pytest

from lab.benchmarks.placeless import drawn, main, read
from scenes.placeless import KINDS, placeless


def test_images_of_a_folder_are_of_the_kinds_of_its_folders(tmp_path: Path) -> None:
    (tmp_path / "doors").mkdir()
    (tmp_path / "notes.txt").write_text("of no kind")
    (tmp_path / "doors" / "notes.txt").write_text("no image")
    for number in range(3):
        cv2.imwrite(str(tmp_path / "doors" / f"{number}.png"), placeless("plain", number)[:, :, ::-1])

    kinds = read(tmp_path, 2)

    assert list(kinds) == ["doors"]
    assert [(one == placeless("plain", number)).all() for number, one in enumerate(kinds["doors"])] == [True, True]
    assert {kind: len(images) for kind, images in drawn(1).items()} == dict.fromkeys(KINDS, 1)


def test_each_kind_has_its_row(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "walls").mkdir()
    for number in range(3):
        cv2.imwrite(str(tmp_path / "walls" / f"{number}.png"), placeless("brick", number))

    main(["--images", str(tmp_path), "--encoder", "color", "--count", "3", "--maps", "2", "--places", "1"])

    rows = [line.split(" | ") for line in capsys.readouterr().out.splitlines()[2:]]
    assert [row[0] for row in rows] == ["| walls", "| all"]
    for _, without, shipped, *same in rows:
        assert sum(map(int, without.split(", "))) == sum(map(int, shipped.split(", "))) == 2 * 2
        assert [one.removesuffix(" |").split(" of ")[1] for one in same] == ["2", "2"]
