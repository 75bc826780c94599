import json
from pathlib import Path

import cv2
import pytest

from training.commands.plot_losses import main, plot


def test_every_logged_number_gets_a_panel(tmp_path: Path) -> None:
    lines = [{"step": step, "minutes": step / 10, "label": 3 / step, "similarity": 0.1} for step in (1, 2, 3)]
    (tmp_path / "log.jsonl").write_text("\n".join(map(json.dumps, lines)))
    main([str(tmp_path)])
    one_row = cv2.imread(str(tmp_path / "losses.png"))
    (tmp_path / "log.jsonl").write_text("\n".join(json.dumps(line | {"accuracy": 0.5}) for line in lines))
    main([str(tmp_path)])
    two_rows = cv2.imread(str(tmp_path / "losses.png"))

    assert one_row is not None
    assert two_rows is not None
    assert two_rows.shape == (2 * one_row.shape[0], *one_row.shape[1:])
    assert (two_rows < 255).any()


def test_an_empty_log_is_refused(tmp_path: Path) -> None:
    (tmp_path / "log.jsonl").write_text("")

    with pytest.raises(ValueError, match="has no lines yet"):
        plot(tmp_path / "log.jsonl", tmp_path / "losses.png")
