"""The report: one HTML file with everything in it, pictures included, that can be mailed and kept."""

import base64
import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from lab.evaluation.measuring import Evaluation, Figure, alarms
from lab.evaluation.plots import Series, bars, plot

STYLE = Path(__file__).with_name("report.css")


@dataclass(frozen=True)
class Shown:
    """A picture of the report: PNG or JPEG bytes and what they show; a wide one holds two pictures side by side."""

    caption: str
    data: bytes
    wide: bool = False


@dataclass(frozen=True)
class Example:
    """A query with its answer, right or wrong.

    Parameters
    ----------
    title : str
        Which query, and what happened.
    right : bool or None
        None for pictures that are neither, such as the paper's figures.
    images : sequence of Shown
    """

    title: str
    right: bool | None
    images: Sequence[Shown]


def as_html(evaluations: Sequence[Evaluation], examples: dict[str, list[Example]], title: str = "Evaluation") -> str:
    """The report.

    Parameters
    ----------
    evaluations : sequence of Evaluation
    examples : dict of data set name to list of Example
    title : str
    """
    links = "".join(f'<a href="#set{i}">{escape(e.dataset)}</a>' for i, e in enumerate(evaluations))
    body = [f"<h1>{escape(title)}</h1>", f"<nav>{links}</nav>", _summary(evaluations)]
    for i, evaluation in enumerate(evaluations):
        body.append(f'<section id="set{i}">{_section(evaluation, examples.get(evaluation.dataset, []))}</section>')
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{STYLE.read_text()}</style></head><body>{''.join(body)}</body></html>\n"
    )


def _summary(evaluations: Sequence[Evaluation]) -> str:
    """recall@1 of every method on every set."""
    names = list(dict.fromkeys(m.method for e in evaluations for m in e.methods))
    head = "".join(f"<th>{escape(n)}</th>" for n in names)
    rows = []
    for i, e in enumerate(evaluations):
        by_name = {m.method: m for m in e.methods}
        cells = "".join(f"<td>{_cell(by_name[n].recall[0]) if n in by_name else ''}</td>" for n in names)
        link = f'<a href="#set{i}">{escape(e.dataset)}</a>'
        rows.append(f"<tr><td>{link}</td><td>{e.answerable}</td><td>{e.chance[0]:.3f}</td>{cells}</tr>")
    return (
        "<h3>recall@1 over answerable queries, with 95 % intervals</h3>"
        "<p>A perfect order reaches 1 in every row; a random one, the column chance. Intervals come from drawing the "
        "queries again with replacement (neighbours of a drive together).</p>"
        f'<div class="wide"><table><tr><th>set</th><th>queries</th><th>chance</th>{head}</tr>{"".join(rows)}'
        "</table></div>"
    )


def _section(e: Evaluation, examples: Sequence[Example]) -> str:
    facts = (
        f"{e.database} database pictures, {e.queries} queries of which {e.answerable} have a right answer. "
        f"Right means: {e.truth}."
    )
    parts = [f'<h2>{escape(e.dataset)}</h2><p class="facts">{escape(facts)}</p>']
    parts += [f'<div class="alarm"><b>The ground truth is odd:</b> {escape(s)}</div>' for s in e.suspicions]
    parts += [_alarm(names, causes) for names, causes in alarms(e)]
    parts.append(_table(e))
    parts.append(f'<div class="plots">{_recall_plot(e)}{_known_place_plot(e)}{_reliability_plots(e)}{_times(e)}</div>')
    parts += [_example(x) for x in examples]
    circumstances = "; ".join(f"{k}: {v}" for k, v in e.circumstances.items())
    parts.append(f'<p class="facts">{escape(circumstances)}</p>')
    return "".join(parts)


def _alarm(names: str, causes: Sequence[str]) -> str:
    items = "".join(f"<li>{escape(c)}</li>" for c in causes)
    return (
        f'<div class="alarm"><b>At chance level: {escape(names)}.</b> Queries would have fared as well with each '
        f"other's answers. Likely causes, unless it is a method that knows nothing:<ul>{items}</ul></div>"
    )


def _table(e: Evaluation) -> str:
    head = "".join(f"<th>@{n}</th>" for n in e.depths)
    rows = [
        f"<tr><th>recall</th>{head}<th>of all @1</th><th>best F1</th><th>at full precision</th>"
        "<th>unknown rejected</th><th>calibration error</th><th>re-ranking @1</th></tr>",
        _guide("chance", e.chance, e.chance_of_all[0]),
        _guide("ceiling", [1.0] * len(e.depths), e.ceiling_of_all),
    ]
    for m in e.methods:
        known = m.known_place
        flag = ' <span class="flag">at chance</span>' if m.luck.at_chance else ""
        cells = [f"<td>{escape(m.method)}{flag}</td>", *(f"<td>{_cell(f)}</td>" for f in m.recall)]
        cells.append(f"<td>{m.recall_of_all[0].value:.3f}</td>")
        sure = (known.best_f1, known.recall_at_full_precision, known.rejected) if known else (math.nan,) * 3
        cells += [f"<td>{_share(value)}</td>" for value in sure]
        cells.append(f"<td>{m.calibrated.expected_error:.3f}</td>" if m.calibrated else "<td></td>")
        cells.append(f"<td>{_gain(m.gain[0])}</td>" if m.gain else "<td></td>")
        rows.append(f"<tr>{''.join(cells)}</tr>")
    return f'<div class="wide"><table>{"".join(rows)}</table></div>'


def _guide(name: str, values: Sequence[float], of_all: float) -> str:
    cells = "".join(f"<td>{v:.3f}</td>" for v in values)
    return f'<tr class="guide"><td>{name}</td>{cells}<td>{of_all:.3f}</td>{"<td></td>" * 5}</tr>'


def _recall_plot(e: Evaluation) -> str:
    ticks = (0, 5, 10, 15, 20)
    series = [
        Series(
            m.method,
            [(n, f.value) for n, f in zip(e.depths, m.recall, strict=True)],
            bars=[(f.low, f.high) for f in m.recall],
        )
        for m in e.methods
        if e.answerable
    ]
    series.append(Series("chance", list(zip(e.depths, e.chance, strict=True)), "guide"))
    series.append(Series("ceiling", [(e.depths[0], 1), (e.depths[-1], 1)], "guide"))
    return f"<div><h3>Recall</h3>{plot(series, across='first N answers', up='recall@N', x_ticks=ticks)}</div>"


def _known_place_plot(e: Evaluation) -> str:
    series = [
        Series(m.method, [(r, p) for _, p, r in m.known_place.curve], "steps")
        for m in e.methods
        if m.known_place is not None and len(m.known_place.curve) > 1
    ]
    share = e.chance_of_all[0]
    series.append(Series("chance", [(0, share), (1, share)], "guide"))
    return f"<div><h3>Known place or not</h3>{plot(series, across='recall', up='precision')}</div>"


def _reliability_plots(e: Evaluation) -> str:
    parts = []
    for m in e.methods:
        if m.calibrated is None:
            continue
        filled = [(promised, true) for _, _, n, promised, true in m.calibrated.bins if n]
        counts = [n for _, _, n, _, _ in m.calibrated.bins if n]
        # Binomial standard error, doubled: bins of few queries prove little.
        spread = [2 * (t * (1 - t) / n) ** 0.5 for (_, t), n in zip(filled, counts, strict=True)]
        intervals = [(max(0.0, t - s), min(1.0, t + s)) for (_, t), s in zip(filled, spread, strict=True)]
        lines = [Series(m.method, filled, "line", intervals), Series("what was promised", [(0, 0), (1, 1)], "guide")]
        error = f"expected calibration error {m.calibrated.expected_error:.3f}"
        drawn = plot(lines, across="confidence", up="share right")
        parts.append(f"<div><h3>Reliability: {escape(m.method)}, {error}</h3>{drawn}</div>")
    return "".join(parts)


def _times(e: Evaluation) -> str:
    parts = []
    for m in e.methods:
        if m.timing_ms:
            rows = [(stage, median, high) for stage, (median, high) in m.timing_ms.items()]
            title = f"<h3>Time of a query, {escape(m.method)} (median / 95th percentile)</h3>"
            parts.append(f"<div>{title}{bars(rows, 'ms')}</div>")
    return "".join(parts)


def _example(x: Example) -> str:
    mark = ""
    if x.right is not None:
        mark = '<b class="good">right</b>' if x.right else '<b class="flag">wrong</b>'
    figures = "".join(
        f'<figure class="{"pair" if p.wide else "one"}">'
        f'<img alt="{escape(p.caption)}" src="{_embedded(p.data)}"><figcaption>{escape(p.caption)}</figcaption>'
        "</figure>"
        for p in x.images
    )
    return (
        f'<div class="example"><header>{mark}<span>{escape(x.title)}</span></header>'
        f'<div class="pictures">{figures}</div></div>'
    )


def _embedded(data: bytes) -> str:
    kind = "png" if data.startswith(b"\x89PNG") else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def _cell(f: Figure) -> str:
    return f"{f.value:.3f}<small>{f.low:.2f} to {f.high:.2f}</small>"


def _gain(f: Figure) -> str:
    style = "good" if f.low > 0 else "flag" if f.high < 0 else ""
    return f'<span class="{style}">{f.value:+.3f}</span><small>{f.low:+.2f} to {f.high:+.2f}</small>'


def _share(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.3f}"
