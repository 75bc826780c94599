"""An evaluation as text, as Markdown and as JSON."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from lab.evaluation.measuring import Evaluation, Figure, Figures, alarms


def as_json(evaluations: Sequence[Evaluation]) -> str:
    """Everything that was measured; numbers that do not exist are null."""
    return json.dumps([plain(asdict(e)) for e in evaluations], indent=1, allow_nan=False) + "\n"


def as_text(evaluation: Evaluation) -> str:
    """One set as a table for a terminal, with verdicts and oddities below."""
    rows = [["method", *(f"recall@{n}" for n in evaluation.depths), "all @1", "best F1", "at full precision"]]
    rows.append(["(chance)", *(f"{c:.3f}" for c in evaluation.chance), f"{evaluation.chance_of_all[0]:.3f}", "", ""])
    rows.append(["(ceiling)", *("1.000" for _ in evaluation.depths), f"{evaluation.ceiling_of_all:.3f}", "", ""])
    for method in evaluation.methods:
        known = method.known_place
        figures = [f"{f.value:.3f}" for f in method.recall]
        figures[0] = str(method.recall[0])
        shares = ["", ""] if known is None else [f"{known.best_f1:.3f}", f"{known.recall_at_full_precision:.3f}"]
        rows.append([method.method, *figures, f"{method.recall_of_all[0].value:.3f}", *shares])
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = [
        f"{evaluation.dataset}: {evaluation.queries} queries, {evaluation.answerable} of them answerable, "
        f"{evaluation.database} database images; right: {evaluation.truth}"
    ]
    lines += ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
    for method in evaluation.methods:
        lines += remarks(method)
    for names, causes in alarms(evaluation):
        lines.append(f"AT CHANCE: {names}: queries would have fared as well with each other's answers. Likely causes,")
        lines += ["unless it is a method that knows nothing:", *(f"  - {cause}" for cause in causes)]
    lines += [f"suspicious: {s}" for s in evaluation.suspicions]
    return "\n".join(lines)


def overview(evaluations: Sequence[Evaluation]) -> str:
    """recall@1 of every method on every set as one Markdown table: sets down, methods across."""
    names = list(dict.fromkeys(m.method for e in evaluations for m in e.methods))
    lines = [f"| set | queries | *chance* | {' | '.join(names)} |", "|" + " --- |" * (len(names) + 3)]
    for e in evaluations:
        by_name = {m.method: short(m.recall[0]) for m in e.methods}
        cells = [e.dataset, str(e.answerable), f"{e.chance[0]:.3f}", *(by_name.get(n, "") for n in names)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def short(figure: Figure) -> str:
    """A figure with its interval in few letters: ``0.575 (.51-.64)``."""
    low, high = (f"{v:.2f}".removeprefix("0") for v in (figure.low, figure.high))
    return f"{figure.value:.3f} ({low}-{high})"


def remarks(method: Figures) -> list[str]:
    """What must not be overlooked about a method's figures."""
    found = []
    if method.gain is not None:
        gain = method.gain[0]
        found.append(
            f"{method.method}: re-ranking changed recall@1 by {gain.value:+.3f} [{gain.low:+.3f}, {gain.high:+.3f}]"
        )
    if method.calibrated is not None:
        line = f"{method.method}: expected calibration error {method.calibrated.expected_error:.3f}"
        known = method.known_place
        if known is not None and not math.isnan(known.rejected):
            line += f", {known.rejected:.1%} of the unanswerable queries rejected"
        if known is not None and not math.isnan(known.wrong_claims):
            line += f", {known.wrong_claims:.1%} of its 'matched' wrong"
        found.append(line)
    if method.refused:
        found.append(f"{method.method}: refused " + ", ".join(f"{n} x {code}" for code, n in method.refused.items()))
    return found


def plain(value: Any) -> Any:
    """JSON knows neither NaN nor infinity."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value
