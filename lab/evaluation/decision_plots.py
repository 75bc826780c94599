"""Plots of decisions as SVG: risk over coverage, precision over recall, reliability."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from lab.evaluation.measuring import calibrated
from lab.evaluation.plots import GUIDE, reliability, svg
from lab.metrics.decisions import Decisions, risk_coverage

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def risk(decisions: Decisions) -> bytes:
    """Share of wrong answers among the accepted over the share accepted, the verdict ``matched`` marked."""
    curve = risk_coverage(decisions.confidence, decisions.right)

    def draw(axes: "Axes") -> None:
        axes.plot(curve.coverage, curve.risk, color="C0", label="by confidence")
        # A perfect confidence: no risk up to the share of right answers, wrong ones after that.
        share = float(decisions.right.mean())
        beyond = np.linspace(share, 1, 50)[1:]
        axes.plot([0, share, *beyond], [0, 0, *(1 - share / beyond)], label="least possible", **GUIDE)
        matched = decisions.status == "matched"
        if matched.any():
            axes.plot(matched.mean(), np.mean(~decisions.right[matched]), "o", color="C1", label="matched")
        axes.set(xlabel="coverage", ylabel="risk", xlim=(0, 1.02), ylim=(0, 1.1 * max(float(curve.risk.max()), 0.05)))

    return svg(draw)


def precision(decisions: Decisions) -> bytes:
    """Precision over recall of claiming the most confident first, the verdict ``matched`` marked."""
    curve = decisions.curve

    def draw(axes: "Axes") -> None:
        axes.step(curve.recall, curve.precision, where="post", color="C0", label="by confidence")
        matched, known = decisions.status == "matched", decisions.kind == "known"
        if matched.any() and known.any():
            right = decisions.right & matched
            axes.plot(right.sum() / known.sum(), right.sum() / matched.sum(), "o", color="C1", label="matched")
        axes.set(xlabel="recall", ylabel="precision", xlim=(0, 1.02), ylim=(0, 1.02))

    return svg(draw)


def confidence(decisions: Decisions) -> bytes:
    """Share of right answers over the confidence that was given."""
    return reliability("confidence", calibrated(decisions.confidence, decisions.right))


PLOTS: Mapping[str, Callable[[Decisions], bytes]] = {
    "risk-coverage": risk,
    "precision-recall": precision,
    "reliability": confidence,
}
