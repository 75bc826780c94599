"""What words find is held against label maps."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lab.benchmarks import words
from lab.benchmarks.blurring import IGNORED
from tests.sample_images import encoded
from training.commands.open_data import draw_labelled


def test_what_is_not_found_comes_last() -> None:
    found = [SimpleNamespace(place=place) for place in ("no 1", "yes 1", "yes 2", "yes 3", "yes 4")]
    service: Any = SimpleNamespace(views=lambda into, words: found)
    shares = {"no 1": 0.0, "no 2": 0.01} | {f"yes {number}": 0.5 for number in range(1, 6)}

    outcome = words.searched(service, "town", ["tree", "grass"], shares)
    assert outcome is not None
    assert (outcome.words, outcome.shown, outcome.first) == ("tree,grass", 5 / 7, 5 / 7)
    assert outcome.precision == pytest.approx((1 / 2 + 2 / 3 + 3 / 4 + 4 / 5 + 5 / 7) / 5)
    assert words.searched(service, "town", ["tree"], {**shares, "yes 5": 0.0}) is None


def test_a_folder_of_other_classes_is_told_from_one_where_nothing_is_found(tmp_path: Path) -> None:
    drawn = tmp_path / "drawn"
    for _ in draw_labelled(drawn, 2):
        pass
    (drawn / "classes.json").write_text('{"0": ["unicorn"]}')
    with pytest.raises(SystemExit, match="no class is a label of the map"):
        words.main([str(drawn / "train")])


def test_shares_are_of_the_labelled_pixels(tmp_path: Path) -> None:
    values = np.full((4, 4), IGNORED, np.uint8)
    values[0] = 3
    values[1, :2] = 5
    for part, name in (("labels", "a.png"), ("images", "a.png"), ("labels", "b.png"), ("images", "b.png")):
        (tmp_path / part).mkdir(exist_ok=True)
        nothing = np.full((4, 4), IGNORED, np.uint8)
        (tmp_path / part / name).write_bytes(encoded(values if name == "a.png" else nothing, "png"))
    shares = words.label_shares(tmp_path)
    assert list(shares) == ["a.png"]
    assert (shares["a.png"][3], shares["a.png"][5]) == (pytest.approx(2 / 3), pytest.approx(1 / 3))


def test_drawn_scenes_are_searched(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drawn = tmp_path / "drawn"
    for _ in draw_labelled(drawn, 12):
        pass
    words.main([str(drawn / "train")])
    table = capsys.readouterr().out.splitlines()
    assert "drawn: 12 images, 10 first views" in table
    rows = {cells[1]: [float(cell) for cell in cells[2:7] if cell] for cells in map(cut, table) if len(cells) > 6}
    shown, _, precision = rows["mean"]
    assert precision > shown


def cut(line: str) -> list[str]:
    """Cells of a row with figures."""
    cells = [cell.strip() for cell in line.split("|")]
    return cells if len(cells) > 6 and cells[2][:1].isdigit() else []
