"""Description to ranked views: search, re-rank, verify."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from schemas.description import ContextGraph, Description, Floats
from schemas.errors import Unavailable
from schemas.ports import Store
from schemas.recipe import Recipe
from schemas.records import Candidates, Filters, ViewRecord
from worker.method import channel_fusion, context_graph, dense_cells, hough, score_fusion, verification
from worker.method.byte_vectors import Product, float_product
from worker.method.channel_fusion import HIGH
from worker.method.context_graph import GraphComparison
from worker.method.verification import Verified
from worker.search.catalogue import Catalogue

ROUNDS = 5
"""How often a search may start anew because a view it found was deleted meanwhile."""


class RecipeChanged(Exception):
    """The map changed over to another recipe: the query must be described by that one."""


@dataclass(frozen=True, eq=False)
class Dense:
    """Comparison of dense cells.

    Parameters
    ----------
    similarity : float
        Of the cells at half size, in whichever reading the view stands out more, 0..1.
    median_similarity : float
        Median similarity of all candidates that were compared: what a wrong one gets for this query.
    high : float
        What `HIGH` of them do not exceed: what the wrong ones get that look most like it, such as the few parks in a
        map of streets for the picture of another park.
    shift : (int, int)
        (rows, columns) by which the view's grid moved, in cells of the query's whole grid.
    scale : float or None
        How much larger the view shows the place than the query does, 0.5..2; None where it was not compared in full.
    """

    similarity: float
    median_similarity: float
    high: float
    shift: tuple[int, int]
    scale: float | None


@dataclass(frozen=True, eq=False)
class GraphEvidence:
    """Comparison of context graphs.

    Parameters
    ----------
    similarity : float
        S, 0..1.
    view : ContextGraph
    pairs : tuple of (int, int)
        Corresponding nodes of query and view.
    cosines : tuple of float
        Of the pairs.
    edges_agreeing : int
    """

    similarity: float
    view: ContextGraph
    pairs: tuple[tuple[int, int], ...]
    cosines: tuple[float, ...]
    edges_agreeing: int


@dataclass(frozen=True, eq=False)
class ScoredView:
    """One view that may show the place.

    Parameters
    ----------
    view : ViewRecord
    score : float
        0..1.
    parts : mapping of term to float
        Sum to the score.
    distances, ranks : mapping of channel
        L2 between histogram vectors; rank in that channel's search, None when the channel did not find it.
    dense, graph, verified
        Evidence; None where the recipe or the rank asks for none.
    """

    view: ViewRecord
    score: float
    parts: Mapping[str, float]
    distances: Mapping[str, float]
    ranks: Mapping[str, int | None]
    dense: Dense | None
    graph: GraphEvidence | None
    verified: Verified | None


@dataclass(frozen=True, eq=False)
class Answer:
    """What a search found, best first, at one revision of the map and by one recipe."""

    found: tuple[ScoredView, ...]
    revision: int
    recipe: Recipe
    searched: int
    timing_ms: Mapping[str, float]


class Searcher:
    """Ranks the views of a map against a description.

    The answer depends on the description, the map's revision and the request only.

    Parameters
    ----------
    store : Store
    catalogue : Catalogue
    product : Product
        Multiplies dense cells; how changes the time it takes, not the answer.
    clock : function
        Seconds, for the times in the answer.
    """

    def __init__(
        self,
        store: Store,
        catalogue: Catalogue,
        product: Product = float_product,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._clock = clock
        self._store = store
        self._catalogue = catalogue
        self._product = product

    def search(
        self,
        name: str,
        recipe: Recipe,
        description: Description,
        filters: Filters,
        top: int,
        candidates: int | None = None,
    ) -> Answer:
        """The `top` best views of a map.

        Parameters
        ----------
        name : str
            Of the map.
        recipe : Recipe
            By which `description` was made.
        description : Description
        filters : Filters
        top : int
            At least 1.
        candidates : int, optional
            How many of each channel are re-ranked, instead of the recipe's number; 0 ranks by histograms alone.

        Raises
        ------
        NotFound
            There is no such map.
        RecipeChanged
            The map's recipe is no longer `recipe`.
        """
        reranked = recipe.parameters.candidates if candidates is None else candidates
        for _ in range(ROUNDS):
            began = self._clock()
            index, current = self._catalogue.index(name)
            if current.id != recipe.id:
                raise RecipeChanged
            selection = self._store.select(name, filters)
            found = index.search(description.vectors, max(top, reranked), selection)
            searched = self._clock()
            evidence = self._compare(recipe, description, found, reranked)
            if evidence is not None:
                evidence = self._compare_in_full(recipe, description, found, evidence)
            compared = self._clock()
            verified = None if evidence is None else self._verify(recipe, description, found, evidence)
            ranked = None if verified is None else self._best(recipe, found, verified, top)
            if ranked is None:
                continue  # a view was deleted meanwhile
            return Answer(
                found=ranked,
                revision=found.revision,
                recipe=recipe,
                searched=found.searched,
                timing_ms={
                    "search": (searched - began) * 1000,
                    "rerank": (compared - searched) * 1000,
                    "verify": (self._clock() - compared) * 1000,
                },
            )
        raise Unavailable("the map is being emptied faster than it can be searched; ask again", 1)

    def _compare(
        self, recipe: Recipe, description: Description, found: Candidates, reranked: int
    ) -> "_Evidence | None":
        """Histogram terms of all candidates; dense cells and graphs of those to be re-ranked."""
        parameters = recipe.parameters
        terms = {
            f"histogram.{name}": score_fusion.histogram_similarity(found.distances[name], channel)
            for name, channel in parameters.channels.items()
        }
        chosen = np.zeros(len(found.seqs), np.bool_)
        for ranks in found.ranks.values():
            chosen |= (ranks > 0) & (ranks <= reranked)
        rows = np.flatnonzero(chosen)
        evidence = _Evidence(terms, rows)
        if len(rows) == 0:
            return evidence
        kept = self._store.appearances(found.seqs[rows].tolist(), recipe.id)
        if len(kept) < len(rows):
            return None
        appearances = [kept[int(seq)] for seq in found.seqs[rows]]
        if description.appearance.coarse.size:
            coarse, ours = np.stack([a.coarse for a in appearances]), description.appearance.coarse
            cell_aspect = hough.cell_aspects(description.appearance.extent, [a.extent for a in appearances])
            alike = dense_cells.compare(ours, coarse, self._product, cell_aspect=cell_aspect, measured=False)
            scores = alike.scores
            for channel in () if parameters.dense is None else parameters.dense.read_alone:
                alone = channel_fusion.alone(
                    ours, coarse, parameters.joined(), channel, self._product, cell_aspect=cell_aspect
                )
                evidence.rates[channel] = channel_fusion.align_scale(alike.scores, alone)
                scores = channel_fusion.max_fusion(scores, alone, evidence.rates[channel])
            evidence.put("dense", rows, scores)
            evidence.shifts, evidence.cell_aspect = alike.shifts * 2, cell_aspect
        evidence.graphs = [a.graph for a in appearances]
        evidence.graph = context_graph.compare(
            description.appearance.graph, evidence.graphs, parameters.graph.cosine, parameters.graph.tau
        )
        evidence.put("graph", rows, evidence.graph.similarity)
        return evidence

    def _compare_in_full(
        self, recipe: Recipe, description: Description, found: Candidates, evidence: "_Evidence"
    ) -> "_Evidence | None":
        """Full-size comparison of the dense cells of the best candidates so far."""
        dense = recipe.parameters.dense
        if dense is None or dense.full_resolution_top_k == 0 or evidence.shifts is None:
            return evidence
        first = evidence.best(recipe, found, dense.full_resolution_top_k)
        seqs = found.seqs[first].tolist()
        kept = self._store.cells(seqs, recipe.id)
        if len(kept) < len(first):
            return None
        cells = np.stack([kept[seq] for seq in seqs])
        places = [evidence.place[int(row)] for row in first]
        cell_aspect = evidence.cell_aspect[places]
        alike = dense_cells.compare(description.cells, cells, self._product, cell_aspect=cell_aspect)
        scores = alike.scores
        for channel, full_resolution_top_k in dense.read_alone.items():
            some = (cells[:full_resolution_top_k], recipe.parameters.joined(), channel, self._product)
            alone = channel_fusion.alone(description.cells, *some, cell_aspect=cell_aspect[:full_resolution_top_k])
            scores = channel_fusion.max_fusion(scores, alone, evidence.rates[channel])
        evidence.put("close", first, scores * dense_cells.nearness(alike.scales, dense.scale_penalty))
        evidence.shifts[places] = alike.shifts
        evidence.scales = dict(zip(first.tolist(), alike.scales.tolist(), strict=True))
        return evidence

    def _verify(
        self, recipe: Recipe, description: Description, found: Candidates, evidence: "_Evidence"
    ) -> "_Evidence | None":
        """Geometric verification of the best candidates so far."""
        verification_ = recipe.parameters.verification
        if verification_ is None or description.keypoints is None or len(evidence.rows) == 0:
            return evidence
        first = evidence.best(recipe, found, verification_.candidates).tolist()
        kept = self._store.local_features([int(found.seqs[row]) for row in first], recipe.id)
        if len(kept) < len(first):
            return None
        views = [kept[int(found.seqs[row])] for row in first]
        evidence.verified.update(zip(first, verification.verify(description.keypoints, views), strict=True))
        bonus = verification.gated_bonus(np.array([evidence.verified[row].inliers for row in first]))
        evidence.put("verification", np.array(first, np.intp), bonus)
        return evidence

    def _best(
        self, recipe: Recipe, found: Candidates, evidence: "_Evidence", top: int
    ) -> tuple[ScoredView, ...] | None:
        """The first `top` candidates with their evidence; those that were re-ranked come first."""
        score, parts = score_fusion.score(evidence.terms, recipe.parameters, evidence.rows)
        order = score_fusion.order(score, evidence.distance(found), evidence.rows)[:top]
        views = self._store.views_at(found.seqs[order].tolist())
        if len(views) < len(order):
            return None
        return tuple(
            ScoredView(
                view=views[int(found.seqs[row])],
                score=float(score[row]),
                parts={name: float(part[row]) for name, part in parts.items()},
                distances={name: float(distances[row]) for name, distances in found.distances.items()},
                ranks={name: int(ranks[row]) or None for name, ranks in found.ranks.items()},
                dense=evidence.dense_of(int(row)),
                graph=evidence.graph_of(int(row)),
                verified=evidence.verified.get(int(row)),
            )
            for row in order
        )


class _Evidence:
    """What is known about the candidates of one query.

    Parameters
    ----------
    terms : dict of term to float32 of shape (candidates,)
        0..1; zero where a candidate was not looked at.
    rows : intp of shape (reranked,)
        The candidates that are re-ranked.
    """

    def __init__(self, terms: dict[str, Floats], rows: npt.NDArray[np.intp]) -> None:
        self.terms = terms
        self.rows = rows
        self.place = {int(row): place for place, row in enumerate(rows)}
        self.shifts: npt.NDArray[np.intp] | None = None
        self.cell_aspect: npt.NDArray[np.float64] = np.ones((len(rows), 2))
        self.scales: dict[int, float] = {}
        self.rates: dict[str, float] = {}
        self.graphs: list[ContextGraph] = []
        self.graph: GraphComparison | None = None
        self.verified: dict[int, Verified] = {}

    def put(self, term: str, rows: npt.NDArray[np.intp], values: Floats) -> None:
        """Set a term of some candidates; it is 0 for the others."""
        whole = np.zeros(len(next(iter(self.terms.values()))), np.float32)
        whole[rows] = values
        self.terms[term] = whole

    def best(self, recipe: Recipe, found: Candidates, count: int) -> npt.NDArray[np.intp]:
        """The best re-ranked candidates by what is known so far, best first."""
        score, _ = score_fusion.weigh(self.terms, recipe.parameters.weights)
        return score_fusion.order(score, self.distance(found), self.rows)[: min(count, len(self.rows))]

    def distance(self, found: Candidates) -> Floats:
        """Sum of the channels' histogram distances: settles equal scores."""
        total: Floats = np.sum(list(found.distances.values()), axis=0, dtype=np.float32)
        return total

    def dense_of(self, row: int) -> Dense | None:
        """The comparison of one candidate's dense cells, if it was made."""
        if row not in self.place or self.shifts is None:
            return None
        down, across = self.shifts[self.place[row]].tolist()
        median_similarity, high = np.quantile(self.terms["dense"][self.rows], (0.5, HIGH)).tolist()
        return Dense(float(self.terms["dense"][row]), median_similarity, high, (down, across), self.scales.get(row))

    def graph_of(self, row: int) -> GraphEvidence | None:
        """The comparison of one candidate's graph, if it was made."""
        if row not in self.place or self.graph is None:
            return None
        place = self.place[row]
        matched = self.graph.matched[place]
        nodes = np.flatnonzero(matched >= 0)
        return GraphEvidence(
            similarity=float(self.graph.similarity[place]),
            view=self.graphs[place],
            pairs=tuple((int(node), int(matched[node])) for node in nodes),
            cosines=tuple(float(c) for c in self.graph.cosines[place, nodes]),
            edges_agreeing=int(self.graph.edges_agreeing[place]),
        )
