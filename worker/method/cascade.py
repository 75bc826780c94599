"""Ranking of a query's candidates: every stage, in order.

1. Histogram similarity of all candidates, from the distances that the search measured.
2. For the best of each channel: dense cells at half resolution and the context graph (paper, "Context Graph").
3. For the best so far: dense cells at full resolution.
4. For the best so far: geometric verification by local features.
5. Fusion of all terms into a score and an order.

No I/O: stored data of candidates comes through `Fetch`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from schemas.description import DETAIL, Appearance, ContextGraph, Description, Floats, Int8s, LocalFeatures
from schemas.recipe import DescriptionRecipe, RankingConfig
from schemas.records import Candidates, KnownView, Sequence64
from worker.method import channel_fusion, context_graph, dense_cells, hough, score_fusion, verification
from worker.method.byte_vectors import Product, float_product
from worker.method.context_graph import GraphComparison
from worker.method.hough import Doubles
from worker.method.places import Places
from worker.method.score_fusion import Rows
from worker.method.verification import Verified

RIVALS = 3
"""Views of other places that are compared in full and verified, even if more views of the best place rank above them:
the decision needs to know what the next place gets."""


class ViewGone(Exception):
    """A candidate was deleted between the search and the fetch: search again."""


class Fetch(Protocol):
    """Reads stored data of candidates by sequence number. Every method raises `ViewGone` when a view is missing."""

    def appearances(self, seqs: Sequence[int]) -> list[Appearance]:
        """Half-resolution cells, graphs and extents, in the order of `seqs`."""
        ...

    def cells(self, seqs: Sequence[int]) -> list[Int8s]:
        """Full-resolution cells, int8 (rows, columns, dimensions) each, in the order of `seqs`."""
        ...

    def local_features(self, seqs: Sequence[int]) -> list[LocalFeatures]:
        """Local features, in the order of `seqs`."""
        ...

    def known(self, seqs: Sequence[int]) -> list[KnownView]:
        """Names, positions and the map's own comparisons, in the order of `seqs`."""
        ...


@dataclass(frozen=True, eq=False)
class DenseEvidence:
    """Comparison of dense cells.

    Parameters
    ----------
    similarity : float
        Of the half-resolution cells, 0..1: the larger of all channels' and the aligned detail channel's.
    median_similarity : float
        Median over all compared candidates: typical of a wrong view.
    p85_similarity : float
        85th percentile over all compared candidates: typical of the wrong views most like the query.
    shift : (int, int)
        (rows, columns) by which the view's grid is displaced, in full-resolution cells of the query.
    scale : float or None
        How much larger the view shows the place than the query does, 0.5..2; None without full-resolution comparison.
    detail_rate : float
        Factor on the similarity of detail alone, where that was compared too at the last resolution; otherwise 0.
    """

    similarity: float
    median_similarity: float
    p85_similarity: float
    shift: tuple[int, int]
    scale: float | None
    detail_rate: float = 0.0


@dataclass(frozen=True, eq=False)
class GraphEvidence:
    """Comparison of context graphs.

    Parameters
    ----------
    similarity : float
        S of `worker.method.context_graph.compare`, 0..1.
    view : ContextGraph
    pairs : tuple of (int, int)
        Corresponding nodes of query and view.
    cosines : tuple of float
        Of the pairs.
    edges_agreeing : int
        Edges present in both graphs between corresponding nodes.
    """

    similarity: float
    view: ContextGraph
    pairs: tuple[tuple[int, int], ...]
    cosines: tuple[float, ...]
    edges_agreeing: int


@dataclass(frozen=True, eq=False)
class RankedCandidate:
    """A candidate with its score and the evidence for it.

    Parameters
    ----------
    seq : int
        Sequence number of the view.
    score : float
        0..1, never rising with rank.
    parts : mapping of term to float
        Sum to the score.
    distances : mapping of channel to float
        L2 between histogram vectors.
    ranks : mapping of channel to int or None
        Rank in that channel's search, from 1; None when that search did not return the view.
    dense, graph, verified
        None where the recipe has no such stage or the rank is too low for it.
    """

    seq: int
    score: float
    parts: Mapping[str, float]
    distances: Mapping[str, float]
    ranks: Mapping[str, int | None]
    dense: DenseEvidence | None
    graph: GraphEvidence | None
    verified: Verified | None


@dataclass(frozen=True, eq=False)
class Ranking:
    """All candidates of a query in order, and the first of them with their evidence.

    Parameters
    ----------
    seqs : int64 of shape (candidates,)
        Sequence numbers, best first.
    scores : float32 of shape (candidates,)
    terms : mapping of term to float32 of shape (candidates,)
        0..1, before weighting; zero where a candidate was not compared.
    inliers, matches : intp of shape (candidates,)
        Of the geometric verification; -1 where a candidate was not verified.
    ranks : mapping of channel to int64 of shape (candidates,)
        Rank in that channel's search, from 1; 0 when that search did not return the view.
    reranked : int
        How many were re-ranked: the first ones.
    places : Places
    rival : int or None
        Index of the best re-ranked view that shows another place than the first; None when there is none.
    first : tuple of RankedCandidate
        The first `top`; then the rival, if it is not among them.
    """

    seqs: Sequence64
    scores: Floats
    terms: Mapping[str, Floats]
    inliers: Rows
    matches: Rows
    ranks: Mapping[str, Sequence64]
    reranked: int
    places: Places
    rival: int | None
    first: tuple[RankedCandidate, ...]


@dataclass(eq=False)
class Evidence:
    """Evidence about the candidates of one query, filled in by one stage after another.

    Parameters
    ----------
    candidates : Candidates
    config : RankingConfig
    places : Places
        Of the candidates.
    terms : dict of term to float32 of shape (candidates,)
        0..1; zero where a candidate was not compared.
    rows : intp of shape (reranked,)
        The candidates that are re-ranked.
    appearances : list of Appearance
        Of `rows`.
    cell_aspect : float64 of shape (reranked, 2)
        Height and width of their cells, relative to the query's.
    shifts : intp of shape (reranked, 2), or None without dense cells
        Displacements (rows, columns) of their grids, in full-resolution cells of the query.
    align_scale : float
        Factor that brings similarities of detail alone to the level of those of all channels.
    scales : dict of candidate to float
        How much larger a candidate shows the place; only of those compared at full resolution.
    joined_only : set of candidate
        Those compared at full resolution by all channels together only.
    graph : GraphComparison or None
        Of `rows`.
    verified : dict of candidate to Verified
    """

    candidates: Candidates
    config: RankingConfig
    places: Places
    terms: dict[str, Floats]
    rows: Rows
    appearances: list[Appearance] = field(default_factory=list)
    cell_aspect: Doubles = field(default_factory=lambda: np.ones((0, 2)))
    shifts: npt.NDArray[np.intp] | None = None
    align_scale: float = 0.0
    scales: dict[int, float] = field(default_factory=dict)
    joined_only: set[int] = field(default_factory=set)
    graph: GraphComparison | None = None
    verified: dict[int, Verified] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.place = {int(row): place for place, row in enumerate(self.rows)}

    def put(self, term: str, rows: Rows, values: Floats) -> None:
        """Set a term of some candidates; it is 0 for the others."""
        whole = np.zeros(len(self.candidates.seqs), np.float32)
        whole[rows] = values
        self.terms[term] = whole

    def seqs(self, rows: Rows) -> list[int]:
        """Sequence numbers of some candidates."""
        return [int(seq) for seq in self.candidates.seqs[rows]]

    def best(self, count: int) -> Rows:
        """At most `count` of the re-ranked candidates, best first by the evidence so far.

        Up to `RIVALS` of another place than the first are among them: where there are fewer, they replace the last
        views of its own place and neighbourhood.
        """
        score, _ = score_fusion.weigh(self.terms, self.config.weights.terms())
        order = score_fusion.order(score, self.distance, self.rows)[: len(self.rows)]
        if len(order) <= count:
            return order
        rival = self._apart_from_first(order)
        missing = max(0, min(RIVALS, int(rival.sum())) - int(rival[:count].sum()))
        own = np.flatnonzero(~rival[:count])[1:]
        kept = np.setdiff1d(np.arange(count), own[len(own) - missing :] if missing else own[:0])
        added = count + np.flatnonzero(rival[count:])[: count - len(kept)]
        chosen: Rows = order[np.concatenate([kept, added])]
        return chosen

    def _apart_from_first(self, order: Rows) -> npt.NDArray[np.bool_]:
        """Which rows show another place than the first of them."""
        first, *_ = seqs = self.seqs(order)
        return np.array([self.places.apart(first, seq) for seq in seqs], np.bool_)

    @property
    def distance(self) -> Floats:
        """Sum of the channels' histogram distances, float32 (candidates,): breaks ties of scores."""
        total: Floats = np.sum(list(self.candidates.distances.values()), axis=0, dtype=np.float32)
        return total


Observe = Callable[[str, Evidence], None]
"""Called after each stage with its name and the evidence so far, for measurements."""

STAGES = ("histograms", "coarse", "full", "verification")
"""Names that `Observe` is called with, in order."""


def rank(
    query: Description,
    candidates: Candidates,
    recipe: DescriptionRecipe,
    config: RankingConfig,
    fetch: Fetch,
    *,
    top: int,
    reranked: int | None = None,
    product: Product = float_product,
    observe: Observe = lambda stage, evidence: None,
) -> Ranking:
    """Rank the candidates of a query.

    Parameters
    ----------
    query : Description
    candidates : Candidates
        Results of all channels' searches.
    recipe : DescriptionRecipe
        By which query and candidates were described.
    config : RankingConfig
    fetch : Fetch
    top : int
        How many are returned with their evidence at most.
    reranked : int, optional
        How many of each channel are re-ranked, in place of ``config.candidates``; 0 ranks by histograms alone.
    product : Product
        Inner products of dense cells; every implementation gives the same result.
    observe : function
        Called after each of `STAGES`.

    Raises
    ------
    ViewGone
        A candidate was deleted after the search.
    """
    seqs = [int(seq) for seq in candidates.seqs]
    places = Places(dict(zip(seqs, fetch.known(seqs), strict=True)), config.same_place_m)
    evidence = compare_histograms(
        candidates, recipe, config, places, config.candidates if reranked is None else reranked
    )
    observe("histograms", evidence)
    if len(evidence.rows):
        compare_coarse(query, recipe, evidence, fetch, product)
        observe("coarse", evidence)
        compare_full(query, recipe, evidence, fetch, product)
        observe("full", evidence)
        verify(query, evidence, fetch)
    observe("verification", evidence)
    return fuse(evidence, top)


def compare_histograms(
    candidates: Candidates, recipe: DescriptionRecipe, config: RankingConfig, places: Places, reranked: int
) -> Evidence:
    """Stage 1: histogram similarity of all candidates; the best `reranked` of each channel go on to the next stages."""
    terms = {
        f"histogram.{name}": score_fusion.histogram_similarity(candidates.distances[name], channel)
        for name, channel in recipe.parameters.channels.items()
    }
    chosen = np.zeros(len(candidates.seqs), np.bool_)
    for ranks in candidates.ranks.values():
        chosen |= (ranks > 0) & (ranks <= reranked)
    return Evidence(candidates, config, places, terms, np.flatnonzero(chosen))


def compare_coarse(
    query: Description, recipe: DescriptionRecipe, evidence: Evidence, fetch: Fetch, product: Product
) -> None:
    """Stage 2, for re-ranked candidates: half-resolution cells (all channels, and detail alone) and context graphs."""
    evidence.appearances = fetch.appearances(evidence.seqs(evidence.rows))
    ours, config = query.appearance, evidence.config
    if ours.coarse.size:
        coarse = np.stack([a.coarse for a in evidence.appearances])
        aspect = hough.cell_aspects(ours.extent, [a.extent for a in evidence.appearances])
        agreement = dense_cells.compare(ours.coarse, coarse, product, cell_aspect=aspect, measured=False)
        scores = agreement.scores
        if config.detail_only(recipe):
            channels = recipe.parameters.cell_channels()
            alone = channel_fusion.single_channel_similarity(
                ours.coarse, coarse, channels, DETAIL, product, cell_aspect=aspect
            )
            evidence.align_scale = channel_fusion.align_scale(scores, alone)
            scores = channel_fusion.max_fusion(scores, alone, evidence.align_scale)
        evidence.put("dense", evidence.rows, scores)
        evidence.shifts, evidence.cell_aspect = agreement.shifts * 2, aspect
    graphs = [a.graph for a in evidence.appearances]
    evidence.graph = context_graph.compare(ours.graph, graphs, config.graph_cosine, config.graph_max_edge)
    evidence.put("graph", evidence.rows, evidence.graph.similarity)


def compare_full(
    query: Description, recipe: DescriptionRecipe, evidence: Evidence, fetch: Fetch, product: Product
) -> None:
    """Stage 3: full-resolution cells of the best so far."""
    config = evidence.config
    if evidence.shifts is None or config.full_resolution_top_k == 0:
        return
    first = evidence.best(config.full_resolution_top_k)
    cells = np.stack(fetch.cells(evidence.seqs(first)))
    places = [evidence.place[int(row)] for row in first]
    aspect = evidence.cell_aspect[places]
    agreement = dense_cells.compare(query.cells, cells, product, cell_aspect=aspect)
    scores = agreement.scores
    some = config.detail_only(recipe)
    evidence.joined_only.update(first[some:].tolist())
    if some:
        channels = recipe.parameters.cell_channels()
        alone = channel_fusion.single_channel_similarity(
            query.cells, cells[:some], channels, DETAIL, product, cell_aspect=aspect[:some]
        )
        scores = channel_fusion.max_fusion(scores, alone, evidence.align_scale)
    evidence.put("dense_full", first, scores * dense_cells.scale_penalty(agreement.scales, config.scale_penalty))
    evidence.shifts[places] = agreement.shifts
    evidence.scales = dict(zip(first.tolist(), agreement.scales.tolist(), strict=True))


def verify(query: Description, evidence: Evidence, fetch: Fetch) -> None:
    """Stage 4: geometric verification of the best so far."""
    if query.keypoints is None or evidence.config.verified_top_k == 0:
        return
    first = evidence.best(evidence.config.verified_top_k)
    verified = verification.verify(query.keypoints, fetch.local_features(evidence.seqs(first)))
    evidence.verified.update(zip(first.tolist(), verified, strict=True))
    evidence.put("verification", first, verification.gated_bonus([one.inliers for one in verified]))


def fuse(evidence: Evidence, top: int) -> Ranking:
    """Stage 5: candidates by score, re-ranked ones before all others; the first `top` with their evidence."""
    candidates = evidence.candidates
    score, parts = score_fusion.score(evidence.terms, evidence.config, evidence.rows)
    order = score_fusion.order(score, evidence.distance, evidence.rows)
    inliers, matches = np.full((2, len(order)), -1, np.intp)
    for row, verified in evidence.verified.items():
        inliers[row], matches[row] = verified.inliers, verified.matches
    seqs = [int(seq) for seq in candidates.seqs[order]]
    among = range(1, len(evidence.rows) or len(seqs))
    rival = next((i for i in among if evidence.places.apart(seqs[0], seqs[i])), None)
    shown = order[:top] if rival is None or rival < top else order[[*range(min(top, len(order))), rival]]
    first = [
        RankedCandidate(
            seq=int(candidates.seqs[row]),
            score=float(score[row]),
            parts={name: float(part[row]) for name, part in parts.items()},
            distances={name: float(distances[row]) for name, distances in candidates.distances.items()},
            ranks={name: int(ranks[row]) or None for name, ranks in candidates.ranks.items()},
            dense=_dense_of(evidence, int(row)),
            graph=_graph_of(evidence, int(row)),
            verified=evidence.verified.get(int(row)),
        )
        for row in shown
    ]
    return Ranking(
        seqs=candidates.seqs[order],
        scores=score[order],
        terms={name: term[order] for name, term in evidence.terms.items()},
        inliers=inliers[order],
        matches=matches[order],
        ranks={name: ranks[order] for name, ranks in candidates.ranks.items()},
        reranked=len(evidence.rows),
        places=evidence.places,
        rival=rival,
        first=tuple(first),
    )


def _dense_of(evidence: Evidence, row: int) -> DenseEvidence | None:
    """Dense evidence of one candidate; None where its cells were not compared."""
    if row not in evidence.place or evidence.shifts is None:
        return None
    down, across = evidence.shifts[evidence.place[row]].tolist()
    compared = evidence.terms["dense"]
    median, high = np.quantile(compared[evidence.rows], (0.5, channel_fusion.REFERENCE_QUANTILE)).tolist()
    rate = 0.0 if row in evidence.joined_only else evidence.align_scale
    return DenseEvidence(float(compared[row]), median, high, (down, across), evidence.scales.get(row), rate)


def _graph_of(evidence: Evidence, row: int) -> GraphEvidence | None:
    """Graph evidence of one candidate; None where its graph was not compared."""
    if row not in evidence.place or evidence.graph is None:
        return None
    place = evidence.place[row]
    matched = evidence.graph.matched[place]
    nodes = np.flatnonzero(matched >= 0)
    return GraphEvidence(
        similarity=float(evidence.graph.similarity[place]),
        view=evidence.appearances[place].graph,
        pairs=tuple((int(node), int(matched[node])) for node in nodes),
        cosines=tuple(float(c) for c in evidence.graph.cosines[place, nodes]),
        edges_agreeing=int(evidence.graph.edges_agreeing[place]),
    )
