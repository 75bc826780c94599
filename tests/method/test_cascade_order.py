"""What the ranking's terms make together: scores and an order."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from schemas.description import DETAIL, SEMANTIC
from schemas.recipe import RankingConfig, TermWeights
from tests.method.views_in_a_dictionary import (
    FOUND,
    NEAREST_FIRST,
    QUERY,
    Dictionary,
    changed,
    described,
    enrolled,
    found,
    ranked,
    seqs,
)
from worker.method import score_fusion


class TestOrder:
    def test_the_papers_mode_sorts_by_the_graph_alone(self) -> None:
        ranking = ranked(changed(mode="graph"))

        assert all(candidate.parts == {"graph": candidate.score} for candidate in ranking)
        assert all(
            candidate.graph is not None and candidate.graph.similarity == candidate.score for candidate in ranking
        )
        assert ranking[0].seq == 11
        scores = [candidate.score for candidate in ranking]
        assert scores == sorted(scores, reverse=True)
        # Where no node corresponds, all score 0, and the histograms settle the order.
        nothing = [candidate for candidate in ranking if candidate.score == 0]
        assert len(nothing) >= 2
        totals = [sum(candidate.distances.values()) for candidate in nothing]
        assert totals == sorted(totals)

    def test_in_it_too_those_that_were_not_reranked_come_last(self) -> None:
        ranking = ranked(changed(mode="graph"), reranked=1)

        assert set(seqs(ranking)[:2]) == {11, 12}
        assert [candidate.graph is not None for candidate in ranking] == [True, True] + [False] * 4
        assert all(candidate.score <= ranking[1].score for candidate in ranking[2:])

    def test_with_nothing_reranked_the_histograms_alone_decide(self) -> None:
        views, stages = enrolled(), []

        ranking = ranked(views=views, reranked=0, observe=lambda stage, _: stages.append(stage))

        assert views.fetched == []
        assert stages == ["histograms", "verification"]
        assert all(
            candidate.dense is None and candidate.graph is None and candidate.verified is None for candidate in ranking
        )
        # Both channels weigh the same; the vectors have unit length, so that the cosine is 1 - d^2 / 2.
        expected = {
            seq: (1 - one**2 / 2 + 1 - other**2 / 2) / 2
            for seq, one, other in zip(FOUND.seqs.tolist(), *FOUND.distances.values(), strict=True)
        }
        assert {candidate.seq: candidate.score for candidate in ranking} == pytest.approx(expected)
        assert seqs(ranking) == sorted(expected, key=lambda seq: -expected[seq])

    def test_histograms_that_weigh_nothing_decide_all_the_same_where_there_is_nothing_else(self) -> None:
        ranking = ranked(changed(weights=TermWeights(graph=1.0)), reranked=0)

        assert ranking[0].parts.keys() == {"histogram.semantic", "histogram.detail"}
        assert ranking[0].score > 0.8

    @pytest.mark.parametrize("histogram", [{SEMANTIC: 0.04, DETAIL: 0.0}, {SEMANTIC: 0.04}])
    def test_a_histogram_that_weighs_nothing_beside_another_does_not_decide(self, histogram: dict[str, float]) -> None:
        weights = TermWeights(dense=1.0, histogram=histogram)

        ranking = ranked(changed(weights=weights), reranked=0)

        assert seqs(ranking) == [12, 10, 15, 13, 14, 11], "by the channel semantic"
        for candidate in ranking:
            assert candidate.parts[f"histogram.{SEMANTIC}"] == candidate.score
            assert candidate.parts[f"histogram.{DETAIL}"] == 0

    def test_a_map_says_how_many_are_reranked_unless_a_query_does(self) -> None:
        maps, queries = enrolled(), enrolled()

        ranked(changed(candidates=1), views=maps)
        ranked(changed(candidates=1), views=queries, reranked=2)

        assert maps.fetched[0] == ("appearances", [11, 12])
        assert queries.fetched[0] == ("appearances", [10, 11, 12, 13])

    @pytest.mark.parametrize(
        ("weights", "expected"),
        [
            (TermWeights(dense_full=1.0), [11, 13, 15]),
            (TermWeights(dense=1.0), NEAREST_FIRST[:4]),
            (TermWeights(histogram={SEMANTIC: 1.0}), [12, 10, 15, 13, 14, 11]),
            (TermWeights(histogram={DETAIL: 1.0}), [11, 13, 15, 14, 12, 10]),
            (TermWeights(graph=1.0), [11]),
            (TermWeights(verification=1.0), [11]),
        ],
        ids=lambda value: "" if isinstance(value, list) else next(iter(value.terms())),
    )
    def test_a_single_term_is_the_score(self, weights: TermWeights, expected: list[int]) -> None:
        [term] = [name for name, weight in weights.terms().items() if weight > 0]

        ranking = ranked(changed(weights=weights, full_resolution_top_k=100, verified_top_k=100))

        for candidate in ranking:
            assert {name: part for name, part in candidate.parts.items() if part} == {term: candidate.score} or (
                candidate.score == 0 and not any(candidate.parts.values())
            )
        assert seqs(ranking)[: len(expected)] == expected

    def test_a_single_term_that_cannot_be_had_leaves_the_order_to_the_histograms(self) -> None:
        ranking = ranked(changed(weights=TermWeights(verification=1.0)), query=replace(QUERY, keypoints=None))

        assert all(candidate.score == 0 and not any(candidate.parts.values()) for candidate in ranking)
        totals = [sum(candidate.distances.values()) for candidate in ranking]
        assert totals == sorted(totals)


WEIGHT = st.sampled_from([0.0, 0.04, 0.3, 1.0, 1.7, 1000.0])


@st.composite
def rankings(draw: st.DrawFn) -> RankingConfig:
    terms = draw(st.tuples(*[WEIGHT] * 6).filter(any))
    return RankingConfig(
        mode=draw(st.sampled_from(["weighted", "weighted", "graph"])),
        candidates=draw(st.integers(0, 8)),
        weights=TermWeights(
            dense_full=terms[0],
            dense=terms[1],
            histogram={SEMANTIC: terms[2], DETAIL: terms[3]},
            graph=terms[4],
            verification=terms[5],
        ),
        full_resolution_top_k=draw(st.integers(0, 8)),
        detail_only_top_k=draw(st.integers(0, 8)),
        scale_penalty=draw(st.sampled_from([0.0, 0.4])),
        graph_cosine=0.7,
        graph_max_edge=0.5,
        verified_top_k=draw(st.integers(0, 8)),
    )


KEPT = {(seq, noise): described(seq, noise) for seq in range(10, 17) for noise in (0.0, 0.3, 0.8, 4.0)}
"""Described once: making them takes longer than ranking them."""


ROUNDED_UP = RankingConfig(
    candidates=2,
    weights=TermWeights(histogram={SEMANTIC: 0.3, DETAIL: 1.7}, graph=0.3, verification=1.0),
    full_resolution_top_k=0,
    graph_cosine=0.7,
    graph_max_edge=0.5,
    verified_top_k=0,
)
"""Scaled down to the least score of the re-ranked ones, a view that is not came out above it by the last bit."""


HISTOGRAMS_ALONE = RankingConfig(
    candidates=0,
    weights=TermWeights(verification=1.0),
    graph_cosine=0.7,
    graph_max_edge=0.5,
)
"""With one view asked for, only the nearest by each channel were looked at, and not one that is near by both."""


@example(HISTOGRAMS_ALONE, [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, 0.25, 0.25)], 1, False)
@example(HISTOGRAMS_ALONE, [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.0)], 1, False)
@example(ROUNDED_UP, [(0.0, 0.0, 0.0), (0.8, 0.3125, 1.33984375), (0.0, 1.0, 0.0), (0.0, 1.5, 0.9921875)], 4, False)
@given(
    rankings(),
    st.lists(st.tuples(st.sampled_from([0.0, 0.3, 0.8, 4.0]), st.floats(0, 1.5), st.floats(0, 1.5)), max_size=7),
    st.integers(1, 8),
    st.booleans(),
)
def test_scores_are_sums_that_never_rise_and_reranked_views_come_first(
    config: RankingConfig, views: list[tuple[float, float, float]], top: int, verifies: bool
) -> None:
    dictionary = Dictionary({seq: KEPT[seq, noise] for seq, (noise, _, _) in enumerate(views, start=10)})
    candidates = found({SEMANTIC: [one for _, one, _ in views], DETAIL: [other for _, _, other in views]})
    query = QUERY if verifies else replace(QUERY, keypoints=None)

    ranking = ranked(config, query=query, views=dictionary, candidates=candidates, top=top)

    assert len(ranking) == len(set(seqs(ranking))) == min(top, len(views))
    scores = [candidate.score for candidate in ranking]
    assert scores == sorted(scores, reverse=True)
    assert all(0 <= score <= 1 for score in scores)
    for candidate in ranking:
        assert candidate.score == pytest.approx(sum(candidate.parts.values()), abs=1e-6)
        assert all(part >= 0 for part in candidate.parts.values())
    reranked = [min(rank or 99 for rank in candidate.ranks.values()) <= config.candidates for candidate in ranking]
    assert reranked == sorted(reranked, reverse=True)
    assert [candidate.graph is not None for candidate in ranking] == reranked
    everyone = ranked(config, query=query, views=dictionary, candidates=candidates)
    assert seqs(everyone)[:top] == seqs(ranking)


def test_a_score_is_at_most_one_however_its_weights_are_rounded() -> None:
    weights = {"dense_full": 0.2, "dense": 0.4, "graph": 0.4, "verification": 0.5}  # as float32 they sum to 1.0000001

    score, parts = score_fusion.weigh(dict.fromkeys(weights, np.ones(1, np.float32)), weights)

    assert float(np.sum([part[0] for part in parts.values()], dtype=np.float64)) > 1
    assert score.tolist() == [1.0]
