"""Plot a run's losses: ``python -m training.commands.plot_losses runs/NAME`` writes ``losses.png`` beside the log."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path


def plot(log: Path, to: Path) -> None:
    """Plot each logged number over the steps, in a panel of its own.

    Parameters
    ----------
    log : Path
        ``log.jsonl`` of a run.
    to : Path
        Image to write; its ending says of what kind.

    Raises
    ------
    ValueError
        Nothing has been logged yet.
    """
    from matplotlib.figure import Figure  # late: only this command needs it

    lines = [json.loads(line) for line in log.read_text().splitlines()]
    if not lines:
        raise ValueError(f"{log} has no lines yet")
    steps = [line["step"] for line in lines]
    names = [name for name in lines[0] if name not in ("step", "minutes")]
    rows = -(-len(names) // 2)
    figure = Figure(figsize=(9, 2.5 * rows), layout="constrained")
    panels = figure.subplots(rows, 2, sharex=True, squeeze=False).ravel()
    for panel, name in zip(panels, names, strict=False):
        values = [line[name] for line in lines]
        panel.plot(steps, values, linewidth=1)
        panel.set_title(f"{name.replace('_', ' ')}: {values[-1]:.3f}", fontsize=9)
    for panel in panels[len(names) :]:
        panel.set_axis_off()
    for panel in panels[-2:]:
        panel.set_xlabel("step")
    figure.savefig(to)


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m training.commands.plot_losses", description="Plot a run's losses.")
    parser.add_argument("run", type=Path, help="the run's folder")
    folder: Path = parser.parse_args(arguments).run
    plot(folder / "log.jsonl", folder / "losses.png")


if __name__ == "__main__":
    main()
