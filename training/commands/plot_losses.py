"""Draw a run's losses: ``python -m training.commands.plot_losses runs/NAME`` writes ``curves.png`` beside the log."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

PANEL = (180, 420)
MARGIN = 36
INK = (60, 60, 60)
LINE = (170, 90, 30)


def curves(log: Path) -> npt.NDArray[np.uint8]:
    """Draw one panel per logged number, over the steps: BGR uint8, ready to be written."""
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    steps = np.array([line["step"] for line in lines], np.float64)
    names = [name for name in lines[0] if name not in ("step", "minutes")] if lines else []
    panels = [_panel(name, steps, np.array([line[name] for line in lines])) for name in names]
    while len(panels) % 2:
        panels.append(np.full((*PANEL, 3), 255, np.uint8))
    return np.vstack([np.hstack(panels[row : row + 2]) for row in range(0, len(panels), 2)])


def _panel(name: str, steps: npt.NDArray[np.float64], values: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
    height, width = PANEL
    panel = np.full((height, width, 3), 255, np.uint8)
    low, high = float(values.min()), float(values.max())
    x = MARGIN + (steps - steps[0]) / max(float(np.ptp(steps)), 1) * (width - 2 * MARGIN)
    y = height - MARGIN - (values - low) / max(high - low, 1e-9) * (height - 2 * MARGIN)
    cv2.polylines(panel, [np.stack([x, y], axis=1).round().astype(np.int32)], False, LINE, 1, cv2.LINE_AA)
    for text, at in (
        (f"{name.replace('_', ' ')}: {values[-1]:.3f}", (MARGIN, 18)),
        (f"{high:.3g}", (2, MARGIN + 4)),
        (f"{low:.3g}", (2, height - MARGIN + 4)),
        (f"step {int(steps[-1])}", (width - 2 * MARGIN - 30, height - 10)),
    ):
        cv2.putText(panel, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.4, INK, 1, cv2.LINE_AA)
    return panel


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m training.commands.plot_losses", description="Draw a run's losses.")
    parser.add_argument("run", type=Path, help="the run's folder")
    folder = parser.parse_args(arguments).run
    cv2.imwrite(str(folder / "curves.png"), curves(folder / "log.jsonl"))


if __name__ == "__main__":
    main()
