"""The shortlist: in a large map the right view is found although many others have histograms more like the query's."""

import numpy as np
import pytest

from schemas.description import DETAIL, SEMANTIC
from schemas.recipe import RankingConfig
from schemas.records import Candidates
from tests.method.views_in_a_dictionary import (
    CONFIG,
    QUERY,
    Dictionary,
    changed,
    described,
    enrolled,
    found,
    ranked,
    seqs,
)
from worker.method.byte_vectors import quantise
from worker.method.shortlist import (
    GUARANTEED,
    NEAR,
    UNRELATED,
    nearest,
    rough_similarity,
    shortlist,
    worth_a_look,
)
from worker.method.unit_length import unit

CROWD = 120
RIGHT = 10 + 90
"""Sequence number of the right view, the 91st nearest by either channel."""


@pytest.fixture(scope="module")
def crowd() -> Dictionary:
    """Views of other places, and one of the query's."""
    return enrolled([0.2 if seq == RIGHT else 6.0 for seq in range(10, 10 + CROWD)])


def alike(step: float) -> Candidates:
    """Every view a little further off than the one before."""
    distances = [0.5 + step * i for i in range(CROWD)]
    return found({SEMANTIC: distances, DETAIL: distances}, CROWD)


def test_the_right_view_behind_ninety_others_is_found(crowd: Dictionary) -> None:
    config = changed(shortlist_from=100)
    assert seqs(ranked(config, views=crowd, candidates=alike(0.001)))[0] == RIGHT
    assert RIGHT not in seqs(ranked(CONFIG, views=crowd, candidates=alike(0.001)))[:20]


def test_no_more_are_re_ranked_than_the_channels_candidates(crowd: Dictionary) -> None:
    config = changed(shortlist_from=100)
    rows = [c for c in ranked(config, views=crowd, candidates=alike(0.001)) if c.dense is not None]
    assert len(rows) == 2 * CONFIG.candidates


def test_appearances_are_read_once(crowd: Dictionary) -> None:
    crowd.fetched.clear()
    ranked(changed(shortlist_from=100), views=crowd, candidates=alike(0.001))
    assert [len(seqs) for what, seqs in crowd.fetched if what == "appearances"] == [100]


def test_more_can_be_looked_at_and_re_ranked_than_the_size_it_begins_at(crowd: Dictionary) -> None:
    config = changed(shortlist_from=60, shortlist_looked=100, shortlist_kept=70)
    crowd.fetched.clear()
    ranking = ranked(config, views=crowd, candidates=alike(0.001))
    assert [len(seqs) for what, seqs in crowd.fetched if what == "appearances"] == [100]
    assert len([c for c in ranking if c.dense is not None]) == 70
    assert seqs(ranking)[0] == RIGHT
    assert config.searched == 100


def test_what_is_looked_at_is_re_ranked_where_it_is_no_more_than_is_kept(crowd: Dictionary) -> None:
    config = changed(shortlist_from=60, shortlist_looked=100, shortlist_kept=500)
    assert len([c for c in ranked(config, views=crowd, candidates=alike(0.001)) if c.dense is not None]) == 100


def test_a_ranking_without_a_shortlist_searches_for_its_candidates_alone() -> None:
    assert changed(shortlist_looked=1000, shortlist_kept=200).searched == CONFIG.candidates


def test_nothing_is_looked_at_where_the_nearest_stand_out(crowd: Dictionary) -> None:
    """Distances that grow quickly single out few views: the answer is that of a map without a shortlist."""
    crowd.fetched.clear()
    clear = ranked(changed(shortlist_from=100), views=crowd, candidates=alike(0.05), top=5)
    assert [len(seqs) for what, seqs in crowd.fetched if what == "appearances"] == [CONFIG.candidates]
    plain = ranked(CONFIG, views=crowd, candidates=alike(0.05), top=5)
    assert [(c.seq, c.score) for c in clear] == [(c.seq, c.score) for c in plain]


def test_a_small_map_is_answered_as_without() -> None:
    with_it, without = ranked(changed(shortlist_from=100)), ranked(CONFIG)
    assert [(c.seq, c.score, c.ranks) for c in with_it] == [(c.seq, c.score, c.ranks) for c in without]


def test_a_map_that_the_search_nearly_exhausts_has_no_shortlist(crowd: Dictionary) -> None:
    """Its answers stay what they were measured at."""
    all_of_them = ranked(changed(shortlist_from=CROWD), views=crowd, candidates=alike(0.001), top=20)
    without = ranked(CONFIG, views=crowd, candidates=alike(0.001), top=20)
    assert [(c.seq, c.score) for c in all_of_them] == [(c.seq, c.score) for c in without]


def test_an_explicit_number_of_candidates_is_kept_to(crowd: Dictionary) -> None:
    crowd.fetched.clear()
    ranked(changed(shortlist_from=100), views=crowd, candidates=alike(0.001), reranked=15)
    assert [len(seqs) for what, seqs in crowd.fetched if what == "appearances"] == [15]


def test_views_worth_a_look_lie_within_the_limits() -> None:
    limit = 0.5 + NEAR * (UNRELATED - 0.5)
    near = found({"a": [0.5, 0.6, limit - 0.01, limit + 0.01, 1.3]}, 5)
    assert worth_a_look(near, 1, 5).tolist() == [True, True, True, False, False]
    assert worth_a_look(near, 4, 5).tolist() == [True, True, True, True, False], "so many at least"
    assert worth_a_look(near, 1, 2).tolist() == [True, True, False, False, False], "so many at most"


def test_one_channel_is_enough_to_be_worth_a_look() -> None:
    both = found({"a": [0.1, 1.3, 1.4], "b": [1.4, 0.1, 1.4]}, 3)
    assert worth_a_look(both, 1, 3).tolist() == [True, True, False]


def test_a_channel_that_found_nothing_does_not_matter() -> None:
    nothing = Candidates(
        1, 2, np.array([1, 2]), np.arange(2), {"a": np.zeros(2, np.float32)}, {"a": np.zeros(2, np.int64)}
    )
    assert not worth_a_look(nothing, 1, 5).any()


def test_the_nearest_of_each_channel() -> None:
    both = found({"a": [0.1, 0.2, 0.3], "b": [0.3, 0.2, 0.1]}, 3)
    assert nearest(both, 1).tolist() == [True, False, True]


def test_an_image_resembles_itself_most_roughly_too() -> None:
    coarse = [described(seed, noise).appearance.coarse for seed, noise in ((1, 0.0), (2, 0.5), (3, 6.0))]
    similarity = rough_similarity(QUERY.appearance.coarse, coarse)
    assert similarity[0] > similarity[1] > similarity[2]
    assert similarity.min() >= 0
    assert similarity.max() <= 1.01


def test_cells_worked_by_hand() -> None:
    """Four cells of the query, all along the first axis, are one at a quarter size; the candidate has 0.6 of it."""
    query = quantise(np.tile(np.array([1, 0], np.float32), (2, 2, 1)))
    candidate = quantise(np.array([[[0, 1], [0.6, 0.8]], [[-1, 0], [0, -1]]], np.float32))
    assert rough_similarity(query, [candidate])[0] == pytest.approx(0.36, abs=0.01)


@pytest.mark.parametrize("shape", [(1, 14), (8, 1), (1, 1)])
def test_grids_without_a_quarter_size_are_compared_at_half_size(shape: tuple[int, int]) -> None:
    """A recipe may have grids of two or three rows or columns, of which one is left at half size."""
    random = np.random.default_rng(3)
    query, other = (quantise(unit(random.standard_normal((*shape, 16)).astype(np.float32))) for _ in range(2))
    itself, unlike = rough_similarity(query, [query, other])
    assert itself == pytest.approx(1, abs=0.02)
    assert unlike < 0.8


def test_what_is_guaranteed_stays_whatever_its_cells_say() -> None:
    similarity = np.linspace(0, 1, 40).astype(np.float32)
    kept = np.arange(40) < GUARANTEED
    chosen = shortlist({"a": np.ones(40, np.float32)}, similarity, kept, 20)
    assert chosen.tolist() == [*range(GUARANTEED), *range(30, 40)]
    assert shortlist({"a": np.ones(40, np.float32)}, similarity, kept, 5).tolist() == list(range(GUARANTEED))


def test_distance_counts_as_much_as_cells() -> None:
    """Two views that are equally far above the rest, one by its cells and one by its distance, both go on."""
    similarity, distance = np.zeros(10, np.float32), np.ones(10, np.float32)
    similarity[3], distance[7] = 1, 0
    assert shortlist({"a": distance}, similarity, np.zeros(10, np.bool_), 2).tolist() == [3, 7]


def test_old_maps_have_no_shortlist() -> None:
    stored = CONFIG.model_dump()
    del stored["shortlist_from"]
    assert RankingConfig.model_validate(stored).searched == CONFIG.candidates
