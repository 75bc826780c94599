import json
from pathlib import Path

from training.commands.plot_losses import curves


def test_every_logged_number_gets_a_panel(tmp_path: Path) -> None:
    lines = [
        {"step": step, "minutes": step / 10, "word": 3 / step, "likeness": 0.1, "found": 0.5} for step in (1, 2, 3)
    ]
    (tmp_path / "log.jsonl").write_text("\n".join(map(json.dumps, lines)))

    drawn = curves(tmp_path / "log.jsonl")

    assert drawn.shape == (360, 840, 3)  # three panels and an empty one
    assert (drawn < 255).any()
