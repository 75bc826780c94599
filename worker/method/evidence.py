"""Evidence about the candidates of a query, and the ranking that follows from it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from schemas.description import Appearance, Booleans, ContextGraph, Doubles, Floats, Indices
from schemas.recipe import RankingConfig
from schemas.records import Candidates, Sequence64
from worker.method import score_fusion
from worker.method.breadth import breadth
from worker.method.context_graph import GraphComparison
from worker.method.impostors import ImpostorEvidence
from worker.method.places import Places
from worker.method.verification import Verified

RIVALS = 3
"""Views of other places that are compared in full and verified, even if more views of the best place rank above them:
the decision needs to know what the next place gets."""


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
    align_scale : float
        As in `Evidence`, where detail alone was compared too at the last resolution; otherwise 0.
    """

    similarity: float
    median_similarity: float
    p85_similarity: float
    shift: tuple[int, int]
    scale: float | None
    align_scale: float = 0.0


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
    order : int64 of shape (candidates,)
        How many views of the map were enrolled before each of them.
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
        Of those that were re-ranked and of `first`; of all, when none was re-ranked.
    others : int
        Number of other places than the first one's, as far as it matters: `worker.method.places.ENOUGH_PLACES` where
        `ENOUGH_VIEWS` of the searched views may show others and `RIVALS` of the re-ranked ones do, else the number
        among the re-ranked views.
    rivals : tuple of int
        Indices of the re-ranked views that show another place than the first, best first. Its neighbours count as other
        places where fewer than `ENOUGH_VIEWS` views show others.
    cells : mapping of index to float32 of shape (rows * columns,)
        Share of the largest possible weight that agrees at each cell of the query, of views compared at full
        resolution.
    first : tuple of RankedCandidate
        The first `top`.
    candidate : function
        Any of them, by index, with its evidence.
    impostors : ImpostorEvidence or None
        What the query gets of pictures of no place; None where it was compared with none.
    """

    seqs: Sequence64
    order: Sequence64
    scores: Floats
    terms: Mapping[str, Floats]
    inliers: Indices
    matches: Indices
    ranks: Mapping[str, Sequence64]
    reranked: int
    places: Places
    others: int
    rivals: tuple[int, ...]
    cells: Mapping[int, Floats]
    first: tuple[RankedCandidate, ...]
    candidate: Callable[[int], RankedCandidate]
    impostors: ImpostorEvidence | None = None

    @property
    def rival(self) -> int | None:
        """Index of the best view of another place than the first; None when there is none."""
        return self.rivals[0] if self.rivals else None

    @property
    def rival_inliers(self) -> int | None:
        """Largest number of inliers of a view of another place, at least 0; None when no view was verified."""
        if not (self.inliers >= 0).any():
            return None
        return max([0, *(int(self.inliers[i]) for i in self.rivals)])

    def breadth(self, others: Sequence[int], first: int = 0) -> float:
        """Over how much of the query a place leads over views of others: `worker.method.breadth.breadth`.

        For each view of the place that was compared at full resolution the least lead over the others and the
        impostors counts, and of these the largest. So more views of the place never lower it, and more others never
        raise it. It is 0 where the best of the others was not compared.

        Parameters
        ----------
        others : sequence of int
            Indices of other views, best first; none agree nowhere.
        first : int
            Index of a view of the place.
        """
        if others and others[0] not in self.cells:
            return 0.0
        seqs = self.seqs
        own = [cells for i, cells in self.cells.items() if self.places.same(int(seqs[first]), int(seqs[i]))]
        theirs = [self.cells.get(i) for i in others if i in self.cells] or [None]
        theirs += self.impostors.cells if self.impostors else ()
        return max((min(breadth(cells, one) for one in theirs) for cells in own), default=0.0)


@dataclass(eq=False)
class Evidence:
    """Evidence about the candidates of one query, filled in by one stage after another.

    Parameters
    ----------
    candidates : Candidates
    config : RankingConfig
    places : Places
        Of the candidates that are re-ranked; of all, when none is.
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
        Factor that brings similarities of detail alone to the level of those of all channels; 0: not known yet.
    burstiness : dict of channel to float32 of shape (rows * columns,)
        Burstiness weights of the query's cells by that channel, and by ``all``, once computed.
    scales : dict of candidate to float
        How much larger a candidate shows the place; only of those compared at full resolution.
    cells : dict of candidate to float32 of shape (rows * columns,)
        As in `Ranking`, of the same.
    joined_only : set of candidate
        Those compared at full resolution by all channels together only.
    graph : GraphComparison or None
        Of `rows`.
    verified : dict of candidate to Verified

    Attributes
    ----------
    index : dict of candidate to int
        Where it stands in `rows`, and so in what is known of these alone.
    """

    candidates: Candidates
    config: RankingConfig
    places: Places
    terms: dict[str, Floats]
    rows: Indices
    appearances: list[Appearance] = field(default_factory=list)
    cell_aspect: Doubles = field(default_factory=lambda: np.ones((0, 2)))
    shifts: Indices | None = None
    align_scale: float = 0.0
    burstiness: dict[str, Floats] = field(default_factory=dict)
    scales: dict[int, float] = field(default_factory=dict)
    cells: dict[int, Floats] = field(default_factory=dict)
    joined_only: set[int] = field(default_factory=set)
    graph: GraphComparison | None = None
    verified: dict[int, Verified] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.index = {int(row): index for index, row in enumerate(self.rows)}

    def put(self, term: str, rows: Indices, values: Floats) -> None:
        """Set a term of some candidates; it is 0 for the others."""
        whole = np.zeros(len(self.candidates.seqs), np.float32)
        whole[rows] = values
        self.terms[term] = whole

    def seqs(self, rows: Indices) -> list[int]:
        """Sequence numbers of some candidates."""
        return [int(seq) for seq in self.candidates.seqs[rows]]

    def best(self, count: int) -> Indices:
        """At most `count` of the re-ranked candidates, best first by the evidence so far.

        `RIVALS` of them show another place than the first, as far as there are so many: where the first `count` have
        fewer, further ones replace the last views of the first one's own place and neighbourhood.
        """
        order = self.in_order()
        if len(order) <= count:
            return order
        rival = self._apart_from_first(order)
        missing = max(0, min(RIVALS, int(rival.sum())) - int(rival[:count].sum()))
        own = np.flatnonzero(~rival[:count])[1:]
        kept = np.setdiff1d(np.arange(count), own[max(len(own) - missing, 0) :])
        added = count + np.flatnonzero(rival[count:])[: count - len(kept)]
        chosen: Indices = order[np.concatenate([kept, added])]
        return chosen

    def in_order(self) -> Indices:
        """The re-ranked candidates, best first by the evidence so far."""
        score, _ = score_fusion.weigh(self.terms, self.config.weights.terms())
        return score_fusion.order(score, self.distance, self.rows)[: len(self.rows)]

    def counted_once(self, rows: Indices, *leaders: int) -> Indices:
        """Some re-ranked candidates, in their order, with no more than one view of the place of each leader.

        `leaders` are rows too; of those that share a place with one of them the first in `rows` stays.
        """
        for leader in leaders:
            if leader in rows:  # else its place is counted once already
                [of_leader] = self.seqs(np.array([leader], np.intp))
                own = np.flatnonzero([self.places.same(of_leader, seq) for seq in self.seqs(rows)])
                rows = np.delete(rows, own[1:])
        return rows

    def _apart_from_first(self, order: Indices) -> Booleans:
        """Which rows show another place than the first of them."""
        first, *_ = seqs = self.seqs(order)
        return np.array([self.places.apart(first, seq) for seq in seqs], np.bool_)

    @property
    def distance(self) -> Floats:
        """Sum of the channels' histogram distances, float32 (candidates,): breaks ties of scores."""
        total: Floats = np.sum(list(self.candidates.distances.values()), axis=0, dtype=np.float32)
        return total
