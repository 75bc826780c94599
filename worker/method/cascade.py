"""Ranking of a query's candidates: every stage, in order.

0. In a large map, the shortlist: of all views with much the same histograms those whose cells look alike.
1. Histogram similarity of all candidates, from the distances that the search measured.
2. For the best of each channel: dense cells at half resolution and the context graph (paper, "Context Graph").
3. For the best so far: dense cells at full resolution.
4. For the best so far: geometric verification by local features.
5. Fusion of all terms into a score and an order.

No I/O: stored data of candidates comes through `Fetch`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from schemas.comparisons import KnownView
from schemas.description import DETAIL, Appearance, Description, Floats, Int8s, LocalFeatures
from schemas.recipe import DescriptionRecipe, RankingConfig
from schemas.records import Candidates
from worker.method import channel_fusion, context_graph, dense_cells, hough, score_fusion, shortlist, verification
from worker.method.byte_vectors import Product, float_product
from worker.method.evidence import RIVALS, DenseEvidence, Evidence, GraphEvidence, RankedCandidate, Ranking
from worker.method.impostors import COMPARED, ImpostorEvidence, Impostors
from worker.method.places import ENOUGH_PLACES, ENOUGH_VIEWS, Places


class ViewGone(Exception):
    """Candidates were deleted between the search and the fetch, or are damaged: search again without them.

    Parameters
    ----------
    seqs : iterable of int
        Their sequence numbers, as far as known.
    """

    def __init__(self, seqs: Iterable[int] = ()) -> None:
        super().__init__()
        self.seqs = frozenset(seqs)


class FetchCells(Protocol):
    """Reads what stages 1 to 3 compare, by sequence number. Every method raises `ViewGone` when a view is missing."""

    def appearances(self, seqs: Sequence[int]) -> list[Appearance]:
        """Half-resolution cells, graphs and extents, in the order of `seqs`."""
        ...

    def cells(self, seqs: Sequence[int]) -> list[Int8s]:
        """Full-resolution cells, int8 (rows, columns, dimensions) each, in the order of `seqs`."""
        ...

    def known(self, seqs: Sequence[int]) -> list[KnownView]:
        """Names, positions and the map's own comparisons, in the order of `seqs`."""
        ...


class Fetch(FetchCells, Protocol):
    """Reads all stored data of candidates."""

    def local_features(self, seqs: Sequence[int]) -> list[LocalFeatures]:
        """Local features, in the order of `seqs`."""
        ...


Observe = Callable[[str, Evidence], None]
"""Called after each stage with its name and the evidence so far, for measurements."""

LISTED = 100
"""Views of each channel that an answer can list. Not as many as are asked for: whether a view is a candidate, and so
the order, does not depend on how many are wanted."""

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
    impostors: Impostors | None = None,
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
        How many of each channel are re-ranked, in place of ``config.candidates`` and without a shortlist; 0 ranks by
        histograms alone.
    product : Product
        Inner products of dense cells; every implementation gives the same result.
    impostors : Impostors, optional
        Pictures of no place of the map, by the same recipe: what the query gets of them changes no score and no order.
    observe : function
        Called after each of `STAGES`.

    Raises
    ------
    ViewGone
        A candidate was deleted after the search.
    """
    appearances: dict[int, Appearance] = {}
    count = config.candidates if reranked is None else reranked
    if reranked is None:
        candidates, appearances = shorten(query, candidates, config, fetch, product)
    evidence = compare_histograms(candidates, recipe, config, fetch, count, appearances)
    observe("histograms", evidence)
    if len(evidence.rows):
        compare_coarse(query, recipe, evidence, fetch, product)
        observe("coarse", evidence)
        compare_full(query, recipe, evidence, fetch, product)
        observe("full", evidence)
        verify(query, evidence, fetch)
    observe("verification", evidence)
    ranking = fuse(evidence, top, fetch)
    if impostors is None or evidence.shifts is None:
        return ranking
    rival = 0.0 if ranking.rival is None else float(ranking.terms["dense"][ranking.rival])
    return replace(ranking, impostors=compare_impostors(query, recipe, evidence, impostors, product, rival))


def shorten(
    query: Description, candidates: Candidates, config: RankingConfig, fetch: Fetch, product: Product
) -> tuple[Candidates, dict[int, Appearance]]:
    """Stage 0: the candidates that are left, and the appearances of those that are to be re-ranked.

    There is no shortlist, and no appearance given, in a map of at most ``config.shortlist_from`` views, or where the
    distances single out no more than ``config.candidates`` of each channel.
    """
    kept = shortlist.nearest(candidates, max(LISTED, config.candidates))
    large = candidates.searched > config.shortlist_from > config.candidates
    if not large or not query.appearance.coarse.size:
        return shortlist.only(candidates, kept), {}
    most = config.shortlist_looked or config.shortlist_from
    looked = shortlist.worth_a_look(candidates, config.candidates, most)
    count = config.candidates * len(candidates.ranks)
    if looked.sum() <= count:
        return shortlist.only(candidates, kept), {}
    rows = np.flatnonzero(looked)
    appearances = fetch.appearances([int(seq) for seq in candidates.seqs[rows]])
    similarity = shortlist.rough_similarity(query.appearance.coarse, [a.coarse for a in appearances], product)
    distances = {name: of[rows] for name, of in candidates.distances.items()}
    stays = shortlist.nearest(candidates, shortlist.GUARANTEED)[rows]
    chosen = shortlist.shortlist(distances, similarity, stays, config.shortlist_kept or count)
    kept = shortlist.nearest(candidates, LISTED)
    kept[rows[chosen]] = True
    return shortlist.only(candidates, kept), {int(candidates.seqs[rows[i]]): appearances[i] for i in chosen}


def compare_histograms(
    candidates: Candidates,
    recipe: DescriptionRecipe,
    config: RankingConfig,
    fetch: FetchCells,
    reranked: int,
    appearances: Mapping[int, Appearance],
) -> Evidence:
    """Stage 1: histogram similarity of all candidates.

    Those of the shortlist go on to the next stages, or else the best `reranked` of each channel.
    """
    terms = {
        f"histogram.{name}": score_fusion.histogram_similarity(candidates.distances[name], channel)
        for name, channel in recipe.parameters.channels.items()
    }
    chosen = shortlist.nearest(candidates, reranked)
    if appearances:
        chosen = np.isin(candidates.seqs, list(appearances))
    rows = np.flatnonzero(chosen)
    seqs = [int(seq) for seq in (candidates.seqs[rows] if len(rows) else candidates.seqs)]
    places = Places(dict(zip(seqs, fetch.known(seqs), strict=True)), config.same_place_m)
    taken = [appearances[seq] for seq in seqs] if appearances else []
    return Evidence(candidates, config, places, terms, rows, taken)


def compare_coarse(
    query: Description,
    recipe: DescriptionRecipe,
    evidence: Evidence,
    fetch: FetchCells,
    product: Product,
    align_scale: float | None = None,
) -> None:
    """Stage 2, for re-ranked candidates: half-resolution cells (all channels, and detail alone, by the scale of other
    candidates where that is given) and context graphs."""
    evidence.appearances = evidence.appearances or fetch.appearances(evidence.seqs(evidence.rows))
    ours, config = query.appearance, evidence.config
    if ours.coarse.size:
        coarse = np.stack([a.coarse for a in evidence.appearances])
        aspect = hough.cell_aspects(ours.extent, [a.extent for a in evidence.appearances])
        agreement = dense_cells.compare(ours.coarse, coarse, product, cell_aspect=aspect, estimate_scales=False)
        scores = agreement.scores
        if config.detail_only(recipe):
            channels = recipe.parameters.cell_channels()
            alone = channel_fusion.single_channel_agreement(
                ours.coarse, coarse, channels, DETAIL, product, cell_aspect=aspect
            ).scores
            if align_scale is None:
                # Of what comes first the view that was enrolled first: further ones of its place then change nothing.
                leaders = (int(evidence.rows[some.argmax()]) for some in (scores, alone))
                once = np.isin(evidence.rows, evidence.counted_once(evidence.rows, *leaders))
                align_scale = channel_fusion.align_scale(scores[once], alone[once])
            evidence.align_scale = align_scale
            scores = channel_fusion.max_fusion(scores, alone, evidence.align_scale)
        evidence.put("dense", evidence.rows, scores)
        evidence.shifts, evidence.cell_aspect = agreement.shifts * 2, aspect
    graphs = [a.graph for a in evidence.appearances]
    evidence.graph = context_graph.compare(ours.graph, graphs, config.graph_cosine, config.graph_max_edge)
    evidence.put("graph", evidence.rows, evidence.graph.similarity)


def compare_full(
    query: Description, recipe: DescriptionRecipe, evidence: Evidence, fetch: FetchCells, product: Product
) -> None:
    """Stage 3: full-resolution cells of the best so far."""
    config = evidence.config
    if evidence.shifts is None or config.full_resolution_top_k == 0:
        return
    first = evidence.best(config.full_resolution_top_k)
    cells = np.stack(fetch.cells(evidence.seqs(first)))
    indices = [evidence.index[int(row)] for row in first]
    aspect = evidence.cell_aspect[indices]
    known, channels = evidence.burstiness, recipe.parameters.cell_channels()
    if "all" not in known:
        known["all"] = dense_cells.burstiness_weight(query.cells, product=product)
    agreement = dense_cells.compare(query.cells, cells, product, cell_aspect=aspect, burstiness=known["all"])
    scores, parts = agreement.scores, agreement.cells
    count = config.detail_only(recipe)
    evidence.joined_only.update(first[count:].tolist())
    if count:
        if DETAIL not in known:
            known[DETAIL] = channel_fusion.single_channel_burstiness(query.cells, channels, DETAIL, product)
        alone = channel_fusion.single_channel_agreement(
            query.cells, cells[:count], channels, DETAIL, product, cell_aspect=aspect[:count], burstiness=known[DETAIL]
        )
        scores = channel_fusion.max_fusion(scores, alone.scores, evidence.align_scale)
        parts = channel_fusion.max_fusion_cells(agreement, alone, evidence.align_scale)
    evidence.cells = dict(zip(first.tolist(), parts, strict=True))
    evidence.put("dense_full", first, scores * dense_cells.scale_penalty(agreement.scales, config.scale_penalty))
    evidence.shifts[indices] = agreement.shifts
    evidence.scales = dict(zip(first.tolist(), agreement.scales.tolist(), strict=True))


def verify(query: Description, evidence: Evidence, fetch: Fetch) -> None:
    """Stage 4: geometric verification of the best so far, and of the best if the first place had one view only.

    Inliers are measured by the median of the latter. So further views of the first place neither raise that median nor
    push views of other places out of it.
    """
    count = evidence.config.verified_top_k
    if query.keypoints is None or count == 0:
        return
    best, order = evidence.best(count), evidence.in_order()
    usual = evidence.counted_once(order, int(order[0]))[:count]
    first = np.concatenate([best, np.setdiff1d(usual, best)])
    verified = verification.verify(query.keypoints, fetch.local_features(evidence.seqs(first)))
    evidence.verified.update(zip(first.tolist(), verified, strict=True))
    inliers, among = ([evidence.verified[row].inliers for row in rows.tolist()] for rows in (first, usual))
    evidence.put("verification", first, verification.gated_bonus(inliers, among))


def compare_impostors(
    query: Description,
    recipe: DescriptionRecipe,
    evidence: Evidence,
    impostors: Impostors,
    product: Product,
    rival: float,
) -> ImpostorEvidence | None:
    """Stages 1 to 3 for pictures of no place of the map, by the scale, weights and channels that candidates got.

    None where none is as much like the query at half size as the best view of another place, whose `dense` is `rival`:
    then they say no more than that view.
    """
    config = evidence.config
    # `detail_only_top_k` stays: by the channel detail alone they are read where views are, and nowhere else.
    few = config.model_copy(update={"full_resolution_top_k": min(config.full_resolution_top_k, COMPARED)})
    usual = {name: float(found[evidence.rows].mean()) for name, found in evidence.candidates.distances.items()}
    near = impostors.near(query.vectors, query.appearance.coarse, product, usual)
    theirs = compare_histograms(near, recipe, few, impostors, len(near.seqs), {})
    theirs.burstiness = evidence.burstiness
    compare_coarse(query, recipe, theirs, impostors, product, evidence.align_scale)
    if theirs.terms["dense"].max() < rival:
        return None
    compare_full(query, recipe, theirs, impostors, product)
    score, _ = score_fusion.score(theirs.terms, config, theirs.rows)
    best = int(score.argmax())
    elsewhere = bool(near.seqs[best] >= impostors.placeless)
    return ImpostorEvidence(float(score[best]), tuple(theirs.cells.values()), elsewhere)


def fuse(evidence: Evidence, top: int, fetch: Fetch) -> Ranking:
    """Stage 5: candidates by score, re-ranked ones before all others; the first `top` with their evidence."""
    candidates = evidence.candidates
    score, parts = score_fusion.score(evidence.terms, evidence.config, evidence.rows)
    order = score_fusion.order(score, evidence.distance, evidence.rows)
    inliers, matches = np.full((2, len(order)), -1, np.intp)
    for row, verified in evidence.verified.items():
        inliers[row], matches[row] = verified.inliers, verified.matches
    seqs = [int(seq) for seq in candidates.seqs[order]]
    behind = seqs[len(evidence.rows) : top] if len(evidence.rows) else []
    places = evidence.places.joined(dict(zip(behind, fetch.known(behind), strict=True)))
    among = range(1, len(evidence.rows) or len(seqs))
    rivals = [i for i in among if places.apart(seqs[0], seqs[i])]
    few = candidates.searched - (len(among) + 1 - len(rivals)) < ENOUGH_VIEWS
    if few:
        rivals = [i for i in among if not places.same(seqs[0], seqs[i])]
    others = ENOUGH_PLACES
    if few or len(rivals) < RIVALS:  # or views of the first place fill the candidates, or hardly any are re-ranked
        others = len(places.group([seqs[i] for i in rivals]))
    usual = _usual_dense(evidence)

    def candidate(index: int) -> RankedCandidate:
        return _candidate(evidence, score, parts, int(order[index]), usual)

    return Ranking(
        seqs=candidates.seqs[order],
        order=candidates.order[order],
        scores=score[order],
        terms={name: term[order] for name, term in evidence.terms.items()},
        inliers=inliers[order],
        matches=matches[order],
        ranks={name: ranks[order] for name, ranks in candidates.ranks.items()},
        reranked=len(evidence.rows),
        places=places,
        others=others,
        rivals=tuple(rivals),
        cells={i: evidence.cells[row] for i, row in enumerate(order.tolist()) if row in evidence.cells},
        first=tuple(map(candidate, range(min(top, len(seqs))))),
        candidate=candidate,
    )


def _candidate(
    evidence: Evidence, score: Floats, parts: Mapping[str, Floats], row: int, usual: tuple[float, float]
) -> RankedCandidate:
    """One candidate with its evidence; `usual` as `_usual_dense` gives it."""
    candidates = evidence.candidates
    return RankedCandidate(
        seq=int(candidates.seqs[row]),
        score=float(score[row]),
        parts={name: float(part[row]) for name, part in parts.items()},
        distances={name: float(distances[row]) for name, distances in candidates.distances.items()},
        ranks={name: int(ranks[row]) or None for name, ranks in candidates.ranks.items()},
        dense=_dense_of(evidence, row, usual),
        graph=_graph_of(evidence, row),
        verified=evidence.verified.get(row),
    )


def _usual_dense(evidence: Evidence) -> tuple[float, float]:
    """Median and high quantile of the dense similarity over the re-ranked candidates; zeros where none was compared."""
    if evidence.shifts is None:
        return 0.0, 0.0
    compared = evidence.terms["dense"][evidence.rows]
    median, high = np.quantile(compared, (0.5, channel_fusion.REFERENCE_QUANTILE)).tolist()
    return median, high


def _dense_of(evidence: Evidence, row: int, usual: tuple[float, float]) -> DenseEvidence | None:
    """Dense evidence of one candidate; None where its cells were not compared."""
    if row not in evidence.index or evidence.shifts is None:
        return None
    down, across = evidence.shifts[evidence.index[row]].tolist()
    factor = 0.0 if row in evidence.joined_only else evidence.align_scale
    return DenseEvidence(float(evidence.terms["dense"][row]), *usual, (down, across), evidence.scales.get(row), factor)


def _graph_of(evidence: Evidence, row: int) -> GraphEvidence | None:
    """Graph evidence of one candidate; None where its graph was not compared."""
    if row not in evidence.index or evidence.graph is None:
        return None
    index = evidence.index[row]
    matched = evidence.graph.matched[index]
    nodes = np.flatnonzero(matched >= 0)
    return GraphEvidence(
        similarity=float(evidence.graph.similarity[index]),
        view=evidence.appearances[index].graph,
        pairs=tuple((int(node), int(matched[node])) for node in nodes),
        cosines=tuple(float(c) for c in evidence.graph.cosines[index, nodes]),
        edges_agreeing=int(evidence.graph.edges_agreeing[index]),
    )
