"""Every query is compared with pictures of no place of its map; that changes what it is worth, and no order."""

from dataclasses import replace

import numpy as np
import pytest

from schemas.description import DETAIL, SEMANTIC, Description
from schemas.recipe import RankingConfig
from tests.method.views_in_a_dictionary import (
    CONFIG,
    DIMENSIONS,
    FOUND,
    RECIPE,
    Dictionary,
    changed,
    described,
    enrolled,
)
from worker.method import dense_cells
from worker.method.byte_vectors import float_product, quantise
from worker.method.cascade import rank
from worker.method.evidence import Ranking
from worker.method.impostors import COMPARED, LOOKED, Impostors

QUERY = replace(described(), vectors=dict.fromkeys((SEMANTIC, DETAIL), np.eye(8, dtype=np.float32)[0]))


def of(descriptions: list[Description], placeless: int = 100) -> Impostors:
    return Impostors(
        {name: np.stack([vector] * len(descriptions)) for name, vector in QUERY.vectors.items()},
        np.stack([one.cells for one in descriptions]),
        QUERY.appearance.extent,
        placeless,
    )


LIKE_IT = of([described(seed, noise) for seed, noise in ((1, 3.0), (2, 0.2), (3, 2.0), (4, 0.4), (5, 1.0), (6, 0.1))])
UNLIKE_IT = of([described(seed, 9.0) for seed in range(20, 30)])


def ranked(impostors: Impostors | None, config: RankingConfig = CONFIG, views: Dictionary | None = None) -> Ranking:
    return rank(QUERY, FOUND, RECIPE, config, views or enrolled(), top=6, impostors=impostors)


def test_they_change_neither_scores_nor_order() -> None:
    without, compared = ranked(None), ranked(LIKE_IT)

    assert without.impostors is None
    assert compared.impostors is not None
    np.testing.assert_array_equal(without.seqs, compared.seqs)
    np.testing.assert_array_equal(without.scores, compared.scores)
    assert [one.parts for one in without.first] == [one.parts for one in compared.first]


def test_the_most_alike_are_compared() -> None:
    near = LIKE_IT.near(QUERY.vectors, QUERY.appearance.coarse, float_product, {})

    assert near.seqs.tolist() == [1, 3, 4, 5]
    assert len(near.seqs) == LOOKED
    assert len(ranked(LIKE_IT).impostors.cells) == COMPARED  # type: ignore[union-attr]


def test_the_best_of_them_says_whether_it_shows_a_place_elsewhere() -> None:
    worse_and_best = [described(1, 3.0), described(6, 0.1)]
    for placeless, elsewhere in ((2, False), (1, True), (0, True)):
        found = ranked(of(worse_and_best, placeless)).impostors
        assert found is not None
        assert found.elsewhere is elsewhere
    for first in (worse_and_best[::-1], worse_and_best):
        found = ranked(of(first, placeless=1)).impostors
        assert found is not None
        assert found.elsewhere is (first[1] is worse_and_best[1])


def test_they_get_what_views_get_but_for_graphs_and_keypoints() -> None:
    first = ranked(of([described(11, 0.15)])).impostors
    same = ranked(of([QUERY])).impostors

    assert first is not None
    assert same is not None
    counted = {"dense_full", "dense", "histogram.semantic", "histogram.detail"}
    total = sum(CONFIG.weights.terms().values())
    most = sum(weight for name, weight in CONFIG.weights.terms().items() if name in counted) / total
    assert 0 < first.score < same.score <= most + 1e-6
    assert same.score > 0.99 * most


@pytest.mark.parametrize("in_full", [0, 3])
def test_they_are_read_by_detail_alone_only_where_views_are(in_full: int) -> None:
    def score(impostors: Impostors, detail_only: int) -> float:
        config = changed(full_resolution_top_k=in_full, detail_only_top_k=detail_only)
        found = ranked(impostors, config, foggy).impostors
        assert found is not None
        return found.score

    foggy = Dictionary({seq: described(seq, 1.2, 3.0) for seq in range(10, 16)})
    looks_like_it = described(11, 1.2, 0.1)  # by its detail; its meaning is as noisy as theirs
    weights = CONFIG.weights.terms()
    histograms = weights["histogram.semantic"] + weights["histogram.detail"]
    grid = QUERY.appearance.coarse, looks_like_it.appearance.coarse[None]
    expected = histograms + weights["dense"] * float(dense_cells.compare(*grid).scores[0])
    if in_full:
        burstiness = dense_cells.burstiness_weight(QUERY.cells)
        full = dense_cells.compare(QUERY.cells, looks_like_it.cells[None], burstiness=burstiness)
        expected += weights["dense_full"] * float(full.scores[0])

    together, alone = (score(of([looks_like_it]), count) for count in (0, 3))

    assert together == pytest.approx(expected / sum(weights.values()), abs=1e-5)
    assert alone > together + 0.01


def test_those_less_like_the_query_than_another_place_say_nothing() -> None:
    assert ranked(UNLIKE_IT).impostors is None


def test_a_lead_is_broad_only_where_it_is_over_them_too() -> None:
    alone, compared = ranked(None), ranked(of([QUERY]))

    assert alone.breadth(alone.rivals) > 0
    assert compared.breadth(compared.rivals) == 0
    assert compared.breadth(()) == 0


def test_without_histograms_they_are_as_far_as_candidates_are_on_average() -> None:
    without = replace(LIKE_IT, vectors={})
    usual = {SEMANTIC: 0.5, DETAIL: 0.25}

    near = without.near(QUERY.vectors, QUERY.appearance.coarse, float_product, usual)

    assert {name: set(found.tolist()) for name, found in near.distances.items()} == {SEMANTIC: {0.5}, DETAIL: {0.25}}
    alike, farther = ranked(LIKE_IT).impostors, ranked(without).impostors
    assert alike is not None
    assert farther is not None
    assert 0 < farther.score < alike.score  # those of LIKE_IT have the very histograms of the query


def test_detail_counts_for_them_as_for_views_where_that_is_nothing() -> None:
    def plain(one: Description) -> Description:
        cells = one.cells.copy()
        cells[..., :DIMENSIONS] = 0  # of one colour: every cell has the detail of the whole image
        return replace(one, cells=cells, appearance=replace(one.appearance, coarse=quantise(dense_cells.halve(cells))))

    config = changed(detail_only_top_k=2)
    views = Dictionary({seq: plain(described(seq, 3.0)) for seq in range(10, 16)})
    detailed = [described(seed, 4.0, detail=0.6) for seed in range(30, 34)]
    found = ranked(of(detailed), config, views)
    joined_alone = ranked(of(detailed), changed(detail_only_top_k=0), views)

    assert found.first[0].dense is not None
    assert found.first[0].dense.align_scale == 0
    assert found.impostors is not None
    assert joined_alone.impostors is not None
    assert found.impostors.score == joined_alone.impostors.score
