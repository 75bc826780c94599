"""Plots as inline SVG: no library, no script, nothing fetched. Colours come from the report's style sheet."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal

WIDTH, HEIGHT = 460, 300
LEFT, RIGHT, TOP, BOTTOM = 46, 12, 12, 40


@dataclass(frozen=True)
class Series:
    """A line of a plot.

    Parameters
    ----------
    name : str
        In the legend and as the tooltip; empty leaves it out of the legend.
    points : sequence of (x, y)
    kind : str
        ``line``, ``steps``, ``dots``, or ``guide``: thin and dashed, for chance and ceiling.
    bars : sequence of (low, high)
        Interval of each point; empty for none.
    """

    name: str
    points: Sequence[tuple[float, float]]
    kind: Literal["line", "steps", "dots", "guide"] = "line"
    bars: Sequence[tuple[float, float]] = ()


def plot(
    series: Sequence[Series],
    *,
    across: str,
    up: str,
    x_ticks: Sequence[float] = (0, 0.2, 0.4, 0.6, 0.8, 1),
    y_ticks: Sequence[float] = (0, 0.2, 0.4, 0.6, 0.8, 1),
) -> str:
    """Series over common axes, with a legend below; axes reach from the first tick to the last."""
    x_of = _scale(x_ticks[0], x_ticks[-1], LEFT, WIDTH - RIGHT)
    y_of = _scale(y_ticks[0], y_ticks[-1], HEIGHT - BOTTOM, TOP)
    parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(up)} over {escape(across)}">']
    for tick in x_ticks:
        x = x_of(tick)
        parts.append(f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP}" y2="{HEIGHT - BOTTOM}"/>')
        parts.append(f'<text x="{x:.1f}" y="{HEIGHT - BOTTOM + 15}" text-anchor="middle">{tick:g}</text>')
    for tick in y_ticks:
        y = y_of(tick)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(f'<text class="axis" x="{middle}" y="{HEIGHT - 6}" text-anchor="middle">{escape(across)}</text>')
    parts.append(
        f'<text class="axis" transform="translate(12 {(TOP + HEIGHT - BOTTOM) / 2}) rotate(-90)" '
        f'text-anchor="middle">{escape(up)}</text>'
    )
    colour = 0
    legend = []
    for one in series:
        style = "guide" if one.kind == "guide" else f"c{colour % 8}"
        parts.append(_drawn(one, style, x_of, y_of))
        if one.name:
            legend.append(f'<span class="{style}"><i></i>{escape(one.name)}</span>')
        colour += one.kind != "guide"
    parts.append("</svg>")
    return f'<figure class="plot">{"".join(parts)}<figcaption class="legend">{"".join(legend)}</figcaption></figure>'


def bars(rows: Sequence[tuple[str, float, float]], unit: str) -> str:
    """Horizontal bars: (name, value, a longer thin value behind it), such as a median and a 95th percentile."""
    longest = max((max(value, behind) for _, value, behind in rows), default=0) or 1
    height, line = 20 * len(rows) + 8, 20
    x_of = _scale(0, longest, 120, WIDTH - 120)
    parts = [f'<svg viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{escape(unit)} by stage">']
    for i, (name, value, behind) in enumerate(rows):
        y = i * line + 6
        parts.append(f'<text x="112" y="{y + 11}" text-anchor="end">{escape(name)}</text>')
        parts.append(f'<rect class="behind" x="120" y="{y + 5}" width="{x_of(behind) - 120:.1f}" height="4"/>')
        parts.append(f'<rect class="bar" x="120" y="{y + 1}" width="{x_of(value) - 120:.1f}" height="12"/>')
        end = x_of(max(value, behind)) + 6
        parts.append(f'<text x="{end:.1f}" y="{y + 11}">{value:.1f} / {behind:.1f} {escape(unit)}</text>')
    return f'<figure class="plot">{"".join(parts)}</svg></figure>'


def _drawn(one: Series, style: str, x_of: Callable[[float], float], y_of: Callable[[float], float]) -> str:
    places = [(x_of(x), y_of(y)) for x, y in one.points]
    parts = [f'<g class="{style}"><title>{escape(one.name)}</title>']
    for (x, _), (low, high) in zip(places, one.bars, strict=False):
        parts.append(f'<line class="interval" x1="{x:.1f}" x2="{x:.1f}" y1="{y_of(low):.1f}" y2="{y_of(high):.1f}"/>')
    if one.kind != "dots":
        path = []
        for i, (x, y) in enumerate(places):
            if one.kind == "steps" and i:
                path.append(f"{x:.1f},{places[i - 1][1]:.1f}")
            path.append(f"{x:.1f},{y:.1f}")
        parts.append(f'<polyline points="{" ".join(path)}"/>')
    if one.kind in ("dots", "line"):
        parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.2"/>' for x, y in places]
    return "".join(parts) + "</g>"


def _scale(first: float, last: float, start: float, end: float) -> Callable[[float], float]:
    span = (last - first) or 1.0
    return lambda value: start + (value - first) / span * (end - start)
