"""Plots of an evaluation as SVG, drawn by matplotlib. The same figures give the same bytes."""

import io
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from lab.evaluation.measuring import Calibrated, Evaluation, Figures
from lab.libraries import for_studies

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH, HEIGHT = 4.8, 3.6
"""Of a plot, in inches at 72 pixels each."""

BAR_HEIGHT = 0.28
"""Of a stage among the times, in inches."""

GUIDE: dict[str, Any] = {"color": "0.5", "linewidth": 1, "linestyle": "--"}
"""Chance, ceiling, and what a perfect curve would be."""


def recall(e: Evaluation) -> bytes:
    """recall@N over N of every method, with intervals, between chance and ceiling."""

    def draw(axes: "Axes") -> None:
        for number, m in enumerate(e.methods if e.answerable else ()):
            color = f"C{number % 10}"
            axes.plot(e.depths, [f.value for f in m.recall], "o-", color=color, label=m.method)
            axes.vlines(e.depths, [f.low for f in m.recall], [f.high for f in m.recall], color=color, alpha=0.6)
        axes.plot(e.depths, e.chance, label="chance", **GUIDE)
        axes.plot([e.depths[0], e.depths[-1]], [1, 1], label="ceiling", **GUIDE | {"linestyle": ":"})
        axes.set(xlabel="first N answers", ylabel="recall@N", xticks=[0, *e.depths], xlim=(0, None), ylim=(0, 1.02))

    return svg(draw)


def known_place(e: Evaluation) -> bytes:
    """Precision over recall of the claim to know a place, of every method that gives a confidence."""

    def draw(axes: "Axes") -> None:
        for number, m in enumerate(e.methods):
            if m.known_place is not None and len(m.known_place.curve) > 1:
                _, precision, share = zip(*m.known_place.curve, strict=True)
                axes.step(share, precision, where="post", color=f"C{number % 10}", label=m.method)
        axes.axhline(e.chance_of_all[0], label="chance", **GUIDE)
        axes.set(xlabel="recall", ylabel="precision", xlim=(0, 1.02), ylim=(0, 1.02))

    return svg(draw)


def reliability(method: str, calibrated: Calibrated) -> bytes:
    """Share of right answers over the confidence that was given, by bins, with twice the standard error."""

    def draw(axes: "Axes") -> None:
        filled = np.array([(n, promised, true) for _, _, n, promised, true in calibrated.bins if n])
        count, promised, true = filled.reshape(-1, 3).T
        # Binomial: bins of few queries prove little.
        error = 2 * np.sqrt(true * (1 - true) / count)
        axes.plot(promised, true, "o-", color="C0", label=method)
        axes.vlines(promised, np.maximum(0, true - error), np.minimum(1, true + error), color="C0", alpha=0.6)
        axes.plot([0, 1], [0, 1], label="as promised", **GUIDE)
        axes.set(xlabel="confidence", ylabel="share right", xlim=(0, 1.02), ylim=(0, 1.02))

    return svg(draw)


def times(method: Figures) -> bytes:
    """Median and 95th percentile of each stage of a query, in milliseconds."""
    stages = list(method.timing_ms)
    median, high = np.array([method.timing_ms[stage] for stage in stages]).reshape(-1, 2).T

    def draw(axes: "Axes") -> None:
        rows = range(len(stages))
        axes.barh(rows, high, height=0.25, color="C0", alpha=0.35, label="95th percentile")
        axes.barh(rows, median, height=0.7, color="C0", label="median")
        for row in rows:
            text = f"  {median[row]:.1f} / {high[row]:.1f} ms"
            axes.text(max(median[row], high[row]), row, text, va="center", fontsize=8)
        axes.set(yticks=rows, yticklabels=stages, xlabel="ms", xlim=(0, 1.35 * max([*median, *high], default=1) or 1))
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")

    return svg(draw, 1.1 + BAR_HEIGHT * len(stages))


def svg(draw: "Callable[[Axes], None]", height: float = HEIGHT) -> bytes:
    """What `draw` puts on empty axes, with its legend below."""
    with for_studies():
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    out = io.BytesIO()
    style = rc_context(
        {
            "svg.hashsalt": "revisit",  # ids would be random otherwise
            "svg.fonttype": "none",  # text stays text
            "text.parse_math": False,  # a method's name may have dollar signs
            "font.size": 9,
            "axes.grid": True,
            "axes.axisbelow": True,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "grid.color": "0.9",
            "legend.frameon": False,
            "lines.markersize": 4,
        }
    )
    with style:
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        draw(figure.subplots())
        figure.legend(loc="outside lower center", ncols=2)
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()
