"""From answers to figures, each with an interval, chance and ceiling."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from lab.datasets.dataset import Dataset, queries_in_database
from lab.evaluation.querying import Answers
from lab.fitting import reliability
from lab.metrics.chance import Luck, looks_like_chance, suspicions
from lab.metrics.precision_recall import correct_rejection, precision_recall
from lab.metrics.recall import (
    DEPTHS,
    Indices,
    bootstrap_interval,
    ceiling,
    chance,
    first_right,
    found_within,
    recall,
    share_interval,
)
from schemas.description import Booleans, Doubles

RUN = 10
"""Neighbouring queries of a drive that intervals draw together."""


@dataclass(frozen=True)
class Figure:
    """A measured share with its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.3f} [{self.low:.3f}, {self.high:.3f}]"


@dataclass(frozen=True)
class KnownPlace:
    """How well confidence tells known places from unknown ones.

    Parameters
    ----------
    best_f1, at : float
        The best F1 and the confidence from which it is reached.
    recall_at_full_precision, average_precision : float
    rejected : float
        Share of unanswerable queries not claimed: by the service's own status where there is one, otherwise at the
        threshold of the best F1. NaN when every query is answerable.
    wrong_claims : float
        Share of wrong ones among the claims of the service's own status; NaN without claims.
    curve : tuple of (threshold, precision, recall)
    """

    best_f1: float
    at: float
    recall_at_full_precision: float
    average_precision: float
    rejected: float
    wrong_claims: float
    curve: tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Calibrated:
    """How far confidences can be taken at their word: bins of (from, to, queries, promised, true)."""

    expected_error: float
    bins: tuple[tuple[float, float, int, float, float], ...]


@dataclass(frozen=True)
class Figures:
    """Everything measured of one method on one set.

    Parameters
    ----------
    method : str
    recall : tuple of Figure
        recall@N over answerable queries, one for each depth.
    recall_of_all : tuple of Figure
        Over all queries.
    luck : Luck
    known_place : KnownPlace or None
        None when the method gives no confidence.
    calibrated : Calibrated or None
        None when confidences are no probabilities.
    gain : tuple of Figure or None
        What re-ranking added to recall@N, queries paired.
    timing_ms : mapping of stage to (median, 95th percentile)
    refused : mapping of error code to count
    first : tuple of int
        Rank of each query's first right answer, 0 for none: all recalls can be computed again from it.
    """

    method: str
    recall: tuple[Figure, ...]
    recall_of_all: tuple[Figure, ...]
    luck: Luck
    known_place: KnownPlace | None
    calibrated: Calibrated | None = None
    gain: tuple[Figure, ...] | None = None
    timing_ms: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    refused: Mapping[str, int] = field(default_factory=dict)
    first: tuple[int, ...] = ()


@dataclass(frozen=True)
class Evaluation:
    """All methods on one set, with what luck and perfection get.

    Parameters
    ----------
    dataset, truth : str
    database, queries, answerable : int
    depths : tuple of int
    chance, chance_of_all : tuple of float
        Expected recall@N of a random order over answerable and over all queries.
    ceiling_of_all : float
        Recall@N of a perfect order over all queries; over answerable ones it is 1.
    suspicions : tuple of str
        What is odd about the ground truth itself.
    methods : tuple of Figures
    circumstances : mapping of str to str
        Date, versions, threads, seed, memory.
    """

    dataset: str
    truth: str
    database: int
    queries: int
    answerable: int
    depths: tuple[int, ...]
    chance: tuple[float, ...]
    chance_of_all: tuple[float, ...]
    ceiling_of_all: float
    suspicions: tuple[str, ...]
    methods: tuple[Figures, ...] = ()
    circumstances: Mapping[str, str] = field(default_factory=dict)


def alarms(evaluation: Evaluation) -> list[tuple[str, tuple[str, ...]]]:
    """Methods at chance level and the likely causes, those with the same causes together: (who, causes)."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for method in evaluation.methods:
        if method.luck.at_chance:
            groups.setdefault(method.luck.causes, []).append(f"{method.method} (p = {method.luck.p_value:.3f})")
    return [(", ".join(names), causes) for causes, names in groups.items()]


def frame(dataset: Dataset, depths: Sequence[int] = DEPTHS) -> Evaluation:
    """What can be said of a set before any method is tried: sizes, chance, ceiling, oddities."""
    truth = dataset.judged()
    positions = [p for p in (dataset.database_positions, dataset.query_positions) if p is not None]
    return Evaluation(
        dataset=dataset.name,
        truth=dataset.truth,
        database=len(dataset.database),
        queries=len(dataset.queries),
        answerable=int(truth.answerable.sum()),
        depths=tuple(depths),
        chance=tuple(chance(truth, truth.answerable, depths).tolist()),
        chance_of_all=tuple(chance(truth, None, depths).tolist()),
        ceiling_of_all=ceiling(truth),
        suspicions=(
            *_found_in_themselves(dataset),
            *suspicions(truth, np.concatenate(positions) if positions else None),
        ),
    )


def _found_in_themselves(dataset: Dataset) -> list[str]:
    """What is odd about queries that are in the database themselves."""
    found = queries_in_database(dataset)
    if not found:
        return []
    return [
        f"{len(found)} of {len(dataset.queries)} queries are in the database themselves, byte for byte (first: "
        f"{found[0].name}): finding them again says nothing of recognising a place"
    ]


def measure(dataset: Dataset, answers: Answers, *, seed: int = 0, depths: Sequence[int] = DEPTHS) -> list[Figures]:
    """The figures of one method; where it re-ranks, those before re-ranking follow as a second entry.

    Parameters
    ----------
    dataset : Dataset
    answers : Answers
    seed : int
        Of the intervals and of the test against luck.
    depths : sequence of int

    Returns
    -------
    list of Figures
    """
    after = first_right(answers.ranked, dataset.judged())
    if answers.before is None:
        return [_figures(dataset, answers, after, None, seed, depths)]
    first = first_right(answers.before, dataset.judged())
    plain = Answers(f"{answers.method}, histograms alone", answers.before, None)
    return [
        _figures(dataset, answers, after, first, seed, depths),
        _figures(dataset, plain, first, None, seed, depths),
    ]


def _figures(
    dataset: Dataset, answers: Answers, first: Indices, before: Indices | None, seed: int, depths: Sequence[int]
) -> Figures:
    truth = dataset.judged()
    answerable = truth.answerable
    block = RUN if dataset.sequential else 1

    def share(mask: Booleans | None) -> tuple[Figure, ...]:
        chosen = found if mask is None else found[mask]
        return _with_interval(
            recall(first, mask, depths), *share_interval(chosen, np.random.default_rng(seed), block=block)
        )

    found = found_within(first, depths)
    gain = None
    if before is not None:
        difference = (found.astype(np.float64) - found_within(before, depths))[answerable]
        mean = difference.mean(axis=0) if len(difference) else np.full(len(depths), np.nan)
        gain = _with_interval(mean, *bootstrap_interval(difference, np.random.default_rng(seed), block=block))
    right = first == 1
    return Figures(
        method=answers.method,
        recall=share(answerable),
        recall_of_all=share(None),
        luck=looks_like_chance(answers.ranked, truth, np.random.default_rng(seed), depths=depths),
        known_place=_known_place(answers, right, answerable),
        calibrated=calibrated(answers.confidence, right)
        if answers.calibrated and answers.confidence is not None
        else None,
        gain=gain,
        timing_ms={
            stage: (float(np.median(ms)), float(np.quantile(ms, 0.95)))
            for stage, ms in answers.timing_ms.items()
            if len(ms)
        },
        refused=dict(answers.refused),
        first=tuple(first.tolist()),
    )


def _with_interval(means: Doubles, low: Doubles, high: Doubles) -> tuple[Figure, ...]:
    return tuple(Figure(float(m), float(a), float(b)) for m, a, b in zip(means, low, high, strict=True))


def _known_place(answers: Answers, right: Booleans, answerable: Booleans) -> KnownPlace | None:
    if answers.confidence is None:
        return None
    curve = precision_recall(answers.confidence, right, answerable)
    best, at = curve.best_f1
    claimed = answers.confidence >= at if answers.claimed is None else answers.claimed
    own = answers.claimed is not None and bool(answers.claimed.any())
    return KnownPlace(
        best_f1=best,
        at=at,
        recall_at_full_precision=curve.recall_at_full_precision,
        average_precision=curve.average_precision,
        rejected=correct_rejection(claimed, answerable),
        wrong_claims=float(np.mean(~right[claimed])) if own else float("nan"),
        curve=tuple(
            (float(t), float(p), float(r))
            for t, p, r in zip(curve.thresholds, curve.precision, curve.recall, strict=True)
        ),
    )


def calibrated(confidence: Doubles, right: Booleans) -> Calibrated:
    """Promised confidences against what came true, by bins."""
    found = reliability(confidence, right)
    rows = zip(found.edges[:-1], found.edges[1:], found.counts, found.promised, found.true, strict=True)
    bins = tuple((float(a), float(b), int(n), float(p), float(t)) for a, b, n, p, t in rows)
    return Calibrated(found.expected_error, bins)
