"""Whether a robot can act on a verdict: what is accepted, at what risk, and what is accepted by mistake.

Three kinds of queries: ``known``, whose place is enrolled; ``same-site``, taken at the site of the map where nothing is
enrolled; ``other-site``, taken somewhere else altogether. The first two are what a robot meets on its rounds, and are
judged together; how many of the third there are is up to whoever asks, so they are counted for themselves.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from lab.fitting import reliability
from lab.metrics.intervals import Names, Share, block_bootstrap, share
from lab.metrics.precision_recall import PrecisionRecall, precision_recall
from lab.metrics.recall import Indices
from schemas.description import Booleans, Doubles

Kind = Literal["known", "same-site", "other-site"]


@dataclass(frozen=True, eq=False)
class Decisions:
    """What was decided about some queries, and whether the first answer was right.

    Parameters
    ----------
    confidence : float64 of shape (queries,)
        Probability that the first answer is right, 0 without an answer; or any score that grows with it, but then
        `expected_error` means nothing.
    right : bool of shape (queries,)
        Whether the first answer shows the query's place.
    status : str of shape (queries,)
        ``matched``, ``ambiguous`` or ``no_match``.
    kind : str of shape (queries,)
    block : str of shape (queries,)
        Queries of one block resemble each other; intervals draw them together.
    """

    confidence: Doubles
    right: Booleans
    status: Names
    kind: Names
    block: Names

    def __post_init__(self) -> None:
        sizes = {len(column) for column in (self.confidence, self.right, self.status, self.kind, self.block)}
        if len(sizes) != 1:
            raise ValueError(f"one value a query is needed in each column, not {sorted(sizes)}")
        if np.any(self.right & (self.kind != "known")):
            raise ValueError("a query whose place is not enrolled cannot have been answered rightly")

    def __len__(self) -> int:
        return len(self.right)

    def take(self, which: Booleans | Indices) -> "Decisions":
        """Some of the queries, by a mask or by indices, which may repeat."""
        return Decisions(
            self.confidence[which], self.right[which], self.status[which], self.kind[which], self.block[which]
        )

    @property
    def at_site(self) -> "Decisions":
        """The queries of the site itself, known and unknown."""
        return self.take(self.kind != "other-site")

    @property
    def curve(self) -> PrecisionRecall:
        """Precision and recall over all thresholds of the confidence."""
        return precision_recall(self.confidence, self.right, self.kind == "known")


def pooled(parts: Sequence[Decisions]) -> Decisions:
    """Queries of several runs as one."""
    return Decisions(
        np.concatenate([part.confidence for part in parts]),
        np.concatenate([part.right for part in parts]),
        np.concatenate([part.status for part in parts]),
        np.concatenate([part.kind for part in parts]),
        np.concatenate([part.block for part in parts]),
    )


@dataclass(frozen=True, eq=False)
class RiskCoverage:
    """The share of wrong ones among the accepted, over the share that is accepted.

    Parameters
    ----------
    coverage, risk : float64 of shape (distinct confidences,)
        Coverage ascending. Queries of equal confidence are accepted together.
    area : float
        Mean of the risk over coverages 1/n, 2/n, ... 1; of equal confidences each counts with the risk of accepting
        all of them. NaN without queries.
    least_area : float
        What a confidence would get that put all right answers first: errors that no confidence can undo.
    """

    coverage: Doubles
    risk: Doubles
    area: float
    least_area: float

    @property
    def excess_area(self) -> float:
        """Area above the least one: the part that better confidences could save."""
        return self.area - self.least_area


def risk_coverage(confidence: Doubles, right: Booleans) -> RiskCoverage:
    """Risk over coverage of accepting the most confident answers first.

    Parameters
    ----------
    confidence : float64 of shape (queries,)
    right : bool of shape (queries,)
        Accepting an answer to a query of an unknown place is wrong.

    Notes
    -----
    El-Yaniv and Wiener, "On the Foundations of Noise-free Selective Classification", JMLR 2010. Area (AURC) and excess
    area: Geifman, Uziel and El-Yaniv, "Bias-Reduced Uncertainty Estimation for Deep Neural Classifiers", ICLR 2019.
    """
    coverage, risk, area = _accepted(confidence, right)
    return RiskCoverage(coverage, risk, area, _accepted_singly(np.sort(~right)))


def _accepted(confidence: Doubles, right: Booleans) -> tuple[Doubles, Doubles, float]:
    n = len(right)
    if n == 0:
        return np.zeros(0), np.zeros(0), float("nan")
    order = np.argsort(-confidence, kind="stable")
    falling = confidence[order]
    last_of_ties = np.flatnonzero(np.append(falling[1:] != falling[:-1], True))
    accepted = last_of_ties + 1
    risk = np.cumsum(~right[order])[last_of_ties] / accepted
    together = np.diff(accepted, prepend=0)
    return accepted / n, risk, float(np.sum(risk * together) / n)


def _accepted_singly(wrong: Booleans) -> float:
    """Area when answers are accepted one by one in this order."""
    if len(wrong) == 0:
        return float("nan")
    return float(np.mean(np.cumsum(wrong) / np.arange(1, len(wrong) + 1)))


@dataclass(frozen=True)
class Area:
    """A figure that is no share of queries, with its 95 % interval from drawing blocks again."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Summary:
    """The field's measures of some decisions.

    Parameters
    ----------
    right : Share
        Right first answers among known queries: recall@1.
    precision : Share
        Right ones among those ``matched``, of known and same-site queries.
    right_matched, right_ambiguous : Share
        Verdicts on right first answers.
    same_site_matched, same_site_ambiguous, other_site_matched, other_site_ambiguous : Share
        Verdicts on queries of unknown places; ``matched`` is a false accept.
    expected_error : Area
        Expected calibration error, ten bins; of known and same-site queries, as all that follow.
    average_precision : Area
        Area under the precision-recall curve.
    recall_at_full_precision : float
        At the lowest threshold without a wrong claim. An oracle: the threshold is chosen with these very answers.
    risk_area, excess_risk_area : Area
        Area under the risk-coverage curve, and the part above the least possible.
    """

    right: Share
    precision: Share
    right_matched: Share
    right_ambiguous: Share
    same_site_matched: Share
    same_site_ambiguous: Share
    other_site_matched: Share
    other_site_ambiguous: Share
    expected_error: Area
    average_precision: Area
    recall_at_full_precision: float
    risk_area: Area
    excess_risk_area: Area


def summarise(decisions: Decisions, generator: np.random.Generator) -> Summary:
    """All measures of some decisions, each with its interval."""
    site = decisions.at_site

    def of(some: Decisions, happened: Booleans, among: Booleans) -> Share:
        return share(happened, among, some.block, generator)

    def unknown(kind: Kind, status: str) -> Share:
        return of(decisions, decisions.status == status, decisions.kind == kind)

    def area(statistic: Callable[[Decisions], float]) -> Area:
        if len(site) == 0:
            return Area(float("nan"), float("nan"), float("nan"))
        low, high = block_bootstrap(site.block, lambda drawn: statistic(site.take(drawn)), generator)
        return Area(statistic(site), low, high)

    known = (site.kind == "known").any()
    return Summary(
        right=of(site, site.right, site.kind == "known"),
        precision=of(site, site.right, site.status == "matched"),
        right_matched=of(site, site.status == "matched", site.right),
        right_ambiguous=of(site, site.status == "ambiguous", site.right),
        same_site_matched=unknown("same-site", "matched"),
        same_site_ambiguous=unknown("same-site", "ambiguous"),
        other_site_matched=unknown("other-site", "matched"),
        other_site_ambiguous=unknown("other-site", "ambiguous"),
        expected_error=area(lambda d: reliability(d.confidence, d.right).expected_error),
        average_precision=area(lambda d: d.curve.average_precision if (d.kind == "known").any() else float("nan")),
        recall_at_full_precision=site.curve.recall_at_full_precision if known else float("nan"),
        risk_area=area(lambda d: risk_coverage(d.confidence, d.right).area),
        excess_risk_area=area(lambda d: risk_coverage(d.confidence, d.right).excess_area),
    )
