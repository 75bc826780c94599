"""Decisions as Markdown and as JSON: a row for each set and protocol, and all sets of a protocol pooled."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from lab.evaluation.deciding import Decided, as_decisions
from lab.evaluation.tables import plain
from lab.metrics.decisions import Area, Summary, summarise
from lab.metrics.intervals import Share

POOLED = "*all, pooled*"


@dataclass(frozen=True)
class Row:
    """The measures of one set and protocol.

    Parameters
    ----------
    dataset : str
    protocol : str
    summary : Summary
    """

    dataset: str
    protocol: str
    summary: Summary


def rows(decided: Sequence[Decided], seed: int = 0, apart: Sequence[str] = ()) -> list[Row]:
    """Measures of each set, protocol by protocol, the pooled ones after those of the sets.

    Parameters
    ----------
    decided : sequence of Decided
    seed : int
        Of the intervals.
    apart : sequence of str
        Beginnings of names of sets that are not pooled, such as one whose truth is noisy.
    """
    groups: dict[str, dict[str, list[Decided]]] = {}
    for one in decided:
        groups.setdefault(one.protocol, {}).setdefault(one.dataset, []).append(one)
    found = []
    for protocol, sets in groups.items():
        measured = list(sets.items())
        together = [one for name, some in measured if not name.startswith(tuple(apart)) for one in some]
        if len(measured) > 1 and together:
            measured.append((POOLED, together))
        for name, some in measured:
            summary = summarise(as_decisions(some), np.random.default_rng(seed))
            found.append(Row(name, protocol, summary))
    return found


HEAD = (
    "set",
    "known, right first",
    "precision of `matched`",
    "of right `matched`",
    "of right `ambiguous`",
    "same site, unknown",
    "`matched`",
    "`ambiguous`",
    "other site",
    "`matched` per 1,000",
    "`ambiguous`",
    "ECE",
    "AUPR",
    "recall at full precision (oracle)",
    "AURC",
    "above least",
)


def as_markdown(found: Sequence[Row]) -> str:
    """A table for each protocol, shares in percent with their 95 % intervals."""
    tables = []
    for protocol in dict.fromkeys(row.protocol for row in found):
        lines = [f"**{protocol}**", "", f"| {' | '.join(HEAD)} |", "|" + " --- |" * len(HEAD)]
        lines += [f"| {' | '.join(_cells(row))} |" for row in found if row.protocol == protocol]
        tables.append("\n".join(lines))
    return "\n\n".join(tables)


def as_json(found: Sequence[Row], circumstances: Mapping[str, str]) -> dict[str, object]:
    """Everything that was measured; numbers that do not exist are null."""
    listed = [plain(asdict(row)) for row in found]
    return {"circumstances": dict(circumstances), "rows": listed}


def _cells(row: Row) -> list[str]:
    s = row.summary
    return [
        row.dataset,
        _of(s.right),
        _of(s.precision),
        _percent(s.right_matched),
        _percent(s.right_ambiguous),
        _count(s.same_site_matched),
        _percent(s.same_site_matched),
        _percent(s.same_site_ambiguous),
        _count(s.other_site_matched),
        _per_thousand(s.other_site_matched),
        _percent(s.other_site_ambiguous),
        _area(s.expected_error),
        _area(s.average_precision),
        "" if math.isnan(s.recall_at_full_precision) else _short(s.recall_at_full_precision),
        _area(s.risk_area),
        _area(s.excess_risk_area),
    ]


def _count(share: Share) -> str:
    return str(share.queries or "")


def _of(share: Share) -> str:
    """``90.0 (80-97) of 150``."""
    return f"{_percent(share)} of {share.queries}" if share.queries else ""


def _percent(share: Share) -> str:
    if not share.queries:
        return ""
    return f"{100 * share.value:.1f} ({100 * share.low:.0f}-{100 * share.high:.0f})"


def _per_thousand(share: Share) -> str:
    """Rate with its bounds by blocks, then the upper bound as if queries were independent."""
    if not share.queries:
        return ""
    low, high, exact = 1000 * share.low, 1000 * share.high, 1000 * share.exact_high
    return f"{1000 * share.value:.1f} ({low:.1f}-{high:.1f}; singly ≤ {exact:.1f})"


def _area(area: Area) -> str:
    if math.isnan(area.value):
        return ""
    if math.isnan(area.low):
        return _short(area.value)
    return f"{_short(area.value)} ({_short(area.low)}-{_short(area.high)})"


def _short(value: float) -> str:
    return f"{value:.3f}".removeprefix("0")
