"""Views in a dictionary for `worker.method.cascade` to rank, and what a search found of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from schemas.comparisons import KnownView
from schemas.description import DETAIL, SEMANTIC, Appearance, ContextGraph, Description, Floats, Int8s, LocalFeatures
from schemas.recipe import CellGrid, Channel, DescriptionParameters, DescriptionRecipe, RankingConfig, TermWeights
from schemas.records import Candidates
from worker.method import dense_cells
from worker.method.byte_vectors import quantise
from worker.method.cascade import ViewGone, rank
from worker.method.evidence import RankedCandidate
from worker.method.unit_length import unit

ROWS, COLUMNS, DIMENSIONS = 8, 12, 16
WEIGHTS = TermWeights(dense_full=1.0, dense=0.4, histogram={SEMANTIC: 0.1, DETAIL: 0.1}, graph=0.2, verification=0.3)
CONFIG = RankingConfig(
    candidates=20, weights=WEIGHTS, full_resolution_top_k=3, graph_cosine=0.95, graph_max_edge=0.5, verified_top_k=2
)
T = TypeVar("T")


def made_with(*channels: str, dense: CellGrid | None) -> DescriptionRecipe:
    parameters = DescriptionParameters(
        channels={name: Channel(layer=name, vocabulary_size=8) for name in channels}, dense=dense
    )
    return DescriptionRecipe(
        encoder="none", weights="0", labels=("a", "b"), dynamic=(), parameters=parameters, vocabulary="0"
    )


RECIPE = made_with(SEMANTIC, DETAIL, dense=CellGrid(rows=ROWS, columns=COLUMNS, dimensions=DIMENSIONS))
NO_CELLS = np.zeros((0, 0, 0), np.int8)


def noisy(values: Floats, noise: float, random: np.random.Generator) -> Floats:
    return unit(unit(values) + np.float32(noise) * unit(random.standard_normal(values.shape).astype(np.float32)))


def described(seed: int = 1, semantic: float = 0.0, detail: float | None = None) -> Description:
    """The query's description; with noise, that of a view which is the less like it the noisier it is."""
    same, other = np.random.default_rng(0), np.random.default_rng(seed)
    noises = {SEMANTIC: semantic, DETAIL: semantic if detail is None else detail}
    cells = {
        name: noisy(same.standard_normal((ROWS, COLUMNS, DIMENSIONS)).astype(np.float32), noise, other)
        for name, noise in noises.items()
    }
    joined = quantise(dense_cells.join(cells, {}))
    graph = ContextGraph(
        labels=np.array([0, 0, 1, 1], np.int16),
        positions=np.array([[0.1, 0.1], [0.4, 0.2], [0.5, 0.6], [0.9, 0.7]], np.float32),
        embeddings=noisy(same.standard_normal((4, 16)).astype(np.float32), 2 * semantic, other),
        shares=np.full(4, 0.25, np.float32),
    )
    points, descriptors = same.random((40, 2)), same.standard_normal((40, 16)).astype(np.float32)
    features = LocalFeatures(points.astype(np.float32), quantise(noisy(descriptors, 3 * semantic, other)))
    appearance = Appearance(quantise(dense_cells.halve(joined)), graph, (1.0, 0.75))
    return Description({}, appearance, joined, features, np.array([0.5, 0.5], np.float32), 1.0, 100)


QUERY = described()
NOISES = (1.2, 0.0, 2.5, 0.3, 6.0, 0.7)
"""Of the views with the sequence numbers 10, 11, ...: the second is the query's own image."""

NEAREST_FIRST = [11, 13, 15, 10, 12, 14]


@dataclass
class Dictionary:
    """Views by sequence number, and what was fetched of them."""

    views: dict[int, Description]
    fetched: list[tuple[str, list[int]]] = field(default_factory=list)
    gone_before: str = ""
    attributes: dict[int, KnownView] = field(default_factory=dict)

    def appearances(self, seqs: Sequence[int]) -> list[Appearance]:
        return self._fetch("appearances", seqs, lambda view: view.appearance)

    def cells(self, seqs: Sequence[int]) -> list[Int8s]:
        return self._fetch("cells", seqs, lambda view: view.cells)

    def local_features(self, seqs: Sequence[int]) -> list[LocalFeatures]:
        def kept(view: Description) -> LocalFeatures:
            assert view.keypoints is not None
            return view.keypoints

        return self._fetch("local_features", seqs, kept)

    def known(self, seqs: Sequence[int]) -> list[KnownView]:
        if self.gone_before == "known":
            raise ViewGone
        return [self.attributes.get(seq, KnownView()) for seq in seqs]

    def _fetch(self, what: str, seqs: Sequence[int], part: Callable[[Description], T]) -> list[T]:
        self.fetched.append((what, list(seqs)))
        if what == self.gone_before:
            raise ViewGone
        return [part(self.views[seq]) for seq in seqs]


def enrolled(noises: Sequence[float] = NOISES) -> Dictionary:
    return Dictionary({seq: described(seq, noise) for seq, noise in enumerate(noises, start=10)})


def found(distances: Mapping[str, Sequence[float]], count: int = 100) -> Candidates:
    """What a search gives that finds the `count` nearest by each channel."""
    measured = {name: np.array(values, np.float32) for name, values in distances.items()}
    ranks = {name: np.argsort(np.argsort(values, kind="stable")) + 1 for name, values in measured.items()}
    seqs = np.arange(10, 10 + len(next(iter(measured.values()))), dtype=np.int64)
    return Candidates(
        1,
        len(seqs),
        seqs,
        seqs - 10,
        measured,
        {name: np.where(rank <= count, rank, 0) for name, rank in ranks.items()},
    )


FOUND = found({SEMANTIC: [0.3, 0.8, 0.2, 0.5, 0.6, 0.4], DETAIL: [0.7, 0.1, 0.6, 0.2, 0.5, 0.3]})
"""What the histograms say of `NOISES`: nearest by the one channel is the view 12, by the other 11."""


def ranked(
    config: RankingConfig = CONFIG,
    *,
    query: Description = QUERY,
    views: Dictionary | None = None,
    candidates: Candidates = FOUND,
    recipe: DescriptionRecipe = RECIPE,
    **options: Any,
) -> list[RankedCandidate]:
    ranking = rank(query, candidates, recipe, config, views or enrolled(), **{"top": 100} | options)
    return list(ranking.first)


def seqs(ranking: Sequence[RankedCandidate]) -> list[int]:
    return [candidate.seq for candidate in ranking]


def changed(**values: Any) -> RankingConfig:
    return CONFIG.model_copy(update=values)
