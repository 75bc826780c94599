"""What words find is held against label maps."""

from pathlib import Path

import numpy as np
import pytest

from lab.benchmarks import words
from tests.sample_images import encoded
from training.commands.open_data import draw_labelled


def test_a_ranked_list_is_as_good_as_the_precision_up_to_each_that_counts() -> None:
    assert words.average_precision([True, True, False]) == 1
    assert words.average_precision([False, True, False, True]) == pytest.approx((1 / 2 + 2 / 4) / 2)


def test_shares_are_of_the_labelled_pixels(tmp_path: Path) -> None:
    values = np.full((4, 4), words.IGNORED, np.uint8)
    values[0] = 3
    values[1, :2] = 5
    for part, name in (("labels", "a.png"), ("images", "a.png"), ("labels", "b.png"), ("images", "b.png")):
        (tmp_path / part).mkdir(exist_ok=True)
        nothing = np.full((4, 4), words.IGNORED, np.uint8)
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
