"""Have a service decide about queries of known and of unknown places, and keep what it saw."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from lab.datasets.dataset import Dataset
from lab.datasets.protocols import (
    GUARD,
    STRETCHES,
    Query,
    Trial,
    elsewhere,
    halves,
    small_maps,
    whole,
    without_parts,
)
from lab.evaluation.querying import Progress, image_fault, position_of
from lab.evaluation.service import evidence
from lab.metrics.decisions import Decisions, Kind
from schemas.errors import RevisitError
from schemas.records import Position
from worker.method.calibration import Verdict
from worker.service.query import QueryResult

TOP = 5
"""Answers wanted of each query, as over HTTP unless the caller wants others."""

SIZES: Mapping[int, int] = {1: 5, 3: 5, 10: 3, 40: 2, 200: 1}
"""Places of small maps, and how many maps of each size are drawn: the smaller, the more chance is in the draw."""

OTHERS_OF_SMALL_MAPS = 100
"""Queries of other sites that each small map gets."""

OTHERS_OF_EVERYTHING = 300
"""Queries of other sites that the map of everything gets: thousands over ten sets."""


class Deciding(Protocol):
    """A service that decides, with a map of its own that is empty at first."""

    def enroll(self, image: Path, position: Position, place: str | None = None) -> str:
        """Add an image; searchable when this returns."""
        ...

    def result(self, image: Path, top: int) -> QueryResult:
        """The whole result of a query."""
        ...


@dataclass(frozen=True)
class Decided:
    """What was decided about one query.

    Parameters
    ----------
    dataset, protocol : str
    image : str
        Folder and name.
    kind : str
    right : bool
        Whether the first answer shows the query's place.
    status : str
    confidence : float
    block : str
    features : mapping of str to float
        What a calibration may read of the first answer.
    """

    dataset: str
    protocol: str
    image: str
    kind: Kind
    right: bool
    status: Verdict
    confidence: float
    block: str
    features: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Options:
    """How trials are made.

    Parameters
    ----------
    stretches, guard : int
        As `lab.datasets.protocols.halves`.
    sizes : mapping of int to int
        Places of small maps and how many maps are drawn.
    others : int
        Queries of other sites that each small map gets; the map of everything gets `OTHERS_OF_EVERYTHING`.
    spread : bool
        Whether places of small maps come from everywhere instead of one stretch.
    seed : int
    """

    stretches: int = STRETCHES
    guard: int = GUARD
    sizes: Mapping[int, int] = field(default_factory=lambda: dict(SIZES))
    others: int = OTHERS_OF_SMALL_MAPS
    spread: bool = False
    seed: int = 0


def trials(dataset: Dataset, sets: Sequence[Dataset], options: Options) -> list[Trial]:
    """All maps to be made of one set; queries of other sites come from `sets`.

    Raises
    ------
    ValueError
        For online loop closure, where each query has a map of its own.
    """
    if dataset.allowed is not None:
        raise ValueError(f"{dataset.name}: decisions need one map for all queries, not online loop closure")
    generator = np.random.default_rng(options.seed)
    others = elsewhere(dataset, sets)
    few, many = (_drawn(others, count, generator) for count in (options.others, OTHERS_OF_EVERYTHING))
    found = [whole(dataset, many), *halves(dataset, options.stretches, options.guard)]
    found += without_parts(dataset, options.guard)
    for size, draws in options.sizes.items():
        found += small_maps(dataset, size, draws, generator, few, spread=options.spread, guard=options.guard)
    return found


def _drawn(queries: tuple[Query, ...], count: int, generator: np.random.Generator) -> tuple[Query, ...]:
    """At most so many of the queries, in their order."""
    if len(queries) <= count:
        return queries
    return tuple(queries[i] for i in np.sort(generator.choice(len(queries), count, replace=False)))


def decide_all(
    trial: Trial, service: Deciding, *, seed: int = 0, top: int = TOP, progress: Progress | None = None
) -> tuple[list[Decided], dict[str, int]]:
    """Enrol a trial's images with their attributes, and have every query of it decided.

    Parameters
    ----------
    trial : Trial
    service : Deciding
    seed : int
        Of the order of enrolment.
    top : int
    progress : Progress, optional

    Returns
    -------
    (decided, refused)
        One `Decided` a query, and how many images were refused by error code. A query that was refused is one
        without an answer.
    """
    dataset, enrolled = trial.dataset, trial.enrolled
    images: dict[str, set[int]] = {}
    refused: Counter[str] = Counter()
    for image in np.random.default_rng(seed).permutation(enrolled).tolist():
        place = None if dataset.places is None else dataset.places[image]
        try:
            view = service.enroll(dataset.database[image], position_of(dataset, image), place)
            images.setdefault(view, set()).add(image)
        except RevisitError as refusal:
            refused[image_fault(refusal)] += 1
    decided = []
    for done, query in enumerate(trial.queries, start=1):
        status: Verdict = "no_match"
        confidence, right = 0.0, False
        seen: Mapping[str, float] = {}
        try:
            result = service.result(query.image, top)
            status, confidence = result.decision.status, result.decision.confidence
            right, seen = is_right(result, query, images, dataset), evidence(result)
        except RevisitError as refusal:
            refused[image_fault(refusal)] += 1
        name = f"{query.image.parent.name}/{query.image.name}"
        decided.append(
            Decided(dataset.name, trial.protocol, name, query.kind, right, status, confidence, query.block, seen)
        )
        if progress:
            progress(trial.protocol, done, len(trial.queries))
    return decided, refused


def is_right(result: QueryResult, query: Query, images: Mapping[str, set[int]], dataset: Dataset) -> bool:
    """Whether the first answer is a right one, or has the name of a right one's place.

    Parameters
    ----------
    result : QueryResult
    query : Query
    images : mapping of view id to set of int
        Database images that each view stands for; several when they are the same file.
    dataset : Dataset
    """
    if query.kind != "known" or not result.results.views:
        return False
    view = result.results.views[0].view
    if images[view.id] & set(query.right.tolist()):
        return True
    return dataset.places is not None and view.attributes.place in {dataset.places[image] for image in query.right}


def as_decisions(decided: Iterable[Decided]) -> Decisions:
    """The same as columns, for `lab.metrics.decisions`."""
    rows = list(decided)
    return Decisions(
        confidence=np.array([row.confidence for row in rows], np.float64),
        right=np.array([row.right for row in rows], np.bool_),
        status=np.array([row.status for row in rows], np.str_),
        kind=np.array([row.kind for row in rows], np.str_),
        block=np.array([row.block for row in rows], np.str_),
    )
