"""The ranking's stages, one after another: what each reads, and what it leaves to the next."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from schemas.comparisons import KnownView
from schemas.description import DETAIL, SEMANTIC, Description
from schemas.recipe import CellGrid, TermWeights
from tests.method.views_in_a_dictionary import (
    COLUMNS,
    NEAREST_FIRST,
    NO_CELLS,
    NOISES,
    QUERY,
    RECIPE,
    ROWS,
    WEIGHTS,
    Dictionary,
    changed,
    described,
    enrolled,
    found,
    made_with,
    ranked,
    seqs,
)
from worker.method import dense_cells
from worker.method.byte_vectors import quantise
from worker.method.cascade import STAGES, ViewGone, rank
from worker.method.evidence import Evidence, RankedCandidate, Ranking
from worker.method.places import ENOUGH_PLACES


class TestStages:
    def test_they_come_in_order_and_each_adds_its_terms(self) -> None:
        stages: list[str] = []
        terms: list[set[str]] = []

        def observe(stage: str, evidence: Evidence) -> None:
            stages.append(stage)
            terms.append(set(evidence.terms))

        ranked(observe=observe)

        assert tuple(stages) == STAGES == ("histograms", "coarse", "full", "verification")
        histograms = {"histogram.semantic", "histogram.detail"}
        half = histograms | {"dense", "graph"}
        assert terms == [histograms, half, half | {"dense_full"}, half | {"dense_full", "verification"}]

    def test_each_reads_the_best_of_what_the_ones_before_it_say(self) -> None:
        views, best = enrolled(), {}

        def observe(stage: str, evidence: Evidence) -> None:
            best[stage] = evidence.seqs(evidence.best(3 if stage == "coarse" else 2))

        ranking = ranked(views=views, observe=observe)

        assert views.fetched == [
            ("appearances", [10, 11, 12, 13, 14, 15]),
            ("cells", best["coarse"]),
            ("local_features", best["full"]),
        ]
        assert (best["coarse"], best["full"]) == (NEAREST_FIRST[:3], NEAREST_FIRST[:2])
        assert seqs(ranking) == NEAREST_FIRST

    def test_evidence_is_where_its_stage_was_and_nowhere_else(self) -> None:
        ranking = ranked()

        assert [candidate.seq for candidate in ranking if candidate.dense and candidate.dense.scale] == [11, 13, 15]
        assert [candidate.seq for candidate in ranking if candidate.parts["dense_full"] > 0] == [11, 13, 15]
        assert [candidate.seq for candidate in ranking if candidate.verified] == [11, 13]
        assert all(candidate.graph is not None for candidate in ranking)

    def test_the_querys_own_image_agrees_in_everything(self) -> None:
        first = ranked()[0]

        assert first.dense is not None
        assert first.graph is not None
        assert first.verified is not None
        assert first.dense.similarity == pytest.approx(1, abs=0.02)
        assert first.dense.shift == (0, 0)
        assert first.dense.scale == pytest.approx(1, abs=0.01)
        assert first.graph.similarity == 1
        assert first.graph.pairs == ((0, 0), (1, 1), (2, 2), (3, 3))
        assert first.graph.cosines == pytest.approx((1, 1, 1, 1))
        assert first.verified.inliers == first.verified.matches == 40
        assert first.distances == pytest.approx({SEMANTIC: 0.8, DETAIL: 0.1})
        assert first.ranks == {SEMANTIC: 6, DETAIL: 1}

    def test_quantiles_are_over_all_that_were_compared(self) -> None:
        dense = [candidate.dense for candidate in ranked()]

        similarities = [one.similarity for one in dense if one is not None]
        assert len(similarities) == len(NOISES)
        for one in dense:
            assert one is not None
            assert one.median_similarity == pytest.approx(np.quantile(similarities, 0.5))
            assert one.p85_similarity == pytest.approx(np.quantile(similarities, 0.85))

    @pytest.mark.parametrize("stage", ["appearances", "cells", "local_features"])
    def test_a_view_that_is_gone_ends_the_ranking(self, stage: str) -> None:
        views = replace(enrolled(), gone_before=stage)

        with pytest.raises(ViewGone):
            ranked(views=views)
        assert views.fetched[-1][0] == stage

    def test_at_most_top_are_returned_and_they_are_the_first_of_all(self) -> None:
        assert seqs(ranked(top=2)) == NEAREST_FIRST[:2]

    def test_equal_views_come_in_the_order_of_their_enrolment(self) -> None:
        views = Dictionary(dict.fromkeys(range(10, 14), described(7, 0.5)))

        equal = found({SEMANTIC: [0.5] * 4, DETAIL: [0.5] * 4})

        assert seqs(ranked(views=views, candidates=equal)) == [10, 11, 12, 13]

    def test_of_equal_scores_the_nearer_by_histograms_comes_first(self) -> None:
        views = Dictionary(dict.fromkeys(range(10, 13), described(7, 0.5)))
        config = changed(weights=TermWeights(graph=1.0))
        distances = found({SEMANTIC: [0.5, 0.3, 0.5], DETAIL: [0.5, 0.5, 0.2]})

        assert seqs(ranked(config, views=views, candidates=distances)) == [12, 11, 10]

    def test_nothing_found_is_nothing_ranked_and_nothing_fetched(self) -> None:
        views = enrolled()

        assert ranked(views=views, candidates=found({SEMANTIC: [], DETAIL: []})) == []
        assert views.fetched == []


class TestCells:
    def test_a_recipe_without_them_ranks_by_the_rest(self) -> None:
        def without(view: Description) -> Description:
            return replace(view, cells=NO_CELLS, appearance=replace(view.appearance, coarse=NO_CELLS))

        views = enrolled()
        views.views = {seq: without(view) for seq, view in views.views.items()}

        ranking = ranked(query=without(QUERY), views=views, recipe=made_with(SEMANTIC, DETAIL, dense=None))

        assert [what for what, _ in views.fetched] == ["appearances", "local_features"]
        assert all(candidate.dense is None for candidate in ranking)
        assert all(candidate.graph is not None for candidate in ranking)
        assert all(
            candidate.parts.keys() == {"histogram.semantic", "histogram.detail", "graph", "verification"}
            for candidate in ranking
        )
        assert ranking[0].seq == 11

    def test_with_none_in_full_those_at_half_size_decide(self) -> None:
        views = enrolled()

        ranking = ranked(changed(full_resolution_top_k=0), views=views)

        assert [what for what, _ in views.fetched] == ["appearances", "local_features"]
        assert all("dense_full" not in candidate.parts for candidate in ranking)
        assert all(candidate.dense is not None and candidate.dense.scale is None for candidate in ranking)
        assert seqs(ranking) == NEAREST_FIRST

    def test_one_in_full_is_the_best_one(self) -> None:
        views = enrolled()

        ranking = ranked(changed(full_resolution_top_k=1), views=views)

        assert views.fetched[1] == ("cells", [11])
        assert [candidate.parts["dense_full"] > 0 for candidate in ranking] == [True] + [False] * 5

    def test_more_in_full_than_candidates_are_all_of_them(self) -> None:
        views = enrolled()

        ranking = ranked(changed(full_resolution_top_k=100), views=views)

        assert views.fetched[1] == ("cells", NEAREST_FIRST)
        assert all(candidate.dense is not None and candidate.dense.scale is not None for candidate in ranking)

    def test_the_scale_of_a_view_counts_by_its_exponent(self) -> None:
        def zoomed() -> Dictionary:
            views = enrolled([0.0])
            rows, columns = (np.clip((np.arange(n) - n / 2 + 0.5) / 1.25 + n / 2, 0, n - 1) for n in (ROWS, COLUMNS))
            nearer = QUERY.cells[rows.astype(int)][:, columns.astype(int)]
            coarse = quantise(dense_cells.halve(nearer))
            views.views[10] = replace(QUERY, cells=nearer, appearance=replace(QUERY.appearance, coarse=coarse))
            return views

        one = found({SEMANTIC: [0.1], DETAIL: [0.1]})
        [plain] = ranked(changed(scale_penalty=0.0), views=zoomed(), candidates=one)
        [counted] = ranked(changed(scale_penalty=2.0), views=zoomed(), candidates=one)

        assert plain.dense is not None
        assert plain.dense.scale is not None
        assert plain.dense.scale > 1.05
        assert counted.parts["dense_full"] == pytest.approx(plain.parts["dense_full"] / plain.dense.scale**2)


class TestDetailOnly:
    """Of sixteen views whose meaning is noisy (fog, say) two look as the query does: 13, and less so 17."""

    FOUND = found({SEMANTIC: [0.5] * 16, DETAIL: [0.5] * 16})

    def views(self) -> Dictionary:
        looks = {13: 0.1, 17: 0.3}
        return Dictionary({seq: described(seq, 1.2, looks.get(seq, 3.0)) for seq in range(10, 26)})

    def ranked(self, **values: Any) -> list[RankedCandidate]:
        return ranked(changed(full_resolution_top_k=4, **values), views=self.views(), candidates=self.FOUND)

    def similarities(self, **values: Any) -> dict[int, float]:
        ranking = self.ranked(**values)
        return {candidate.seq: candidate.dense.similarity for candidate in ranking if candidate.dense is not None}

    def test_with_none_the_channels_are_only_read_together(self) -> None:
        joined = dense_cells.compare(
            QUERY.appearance.coarse, np.stack([view.appearance.coarse for view in self.views().views.values()])
        )

        similarities = self.similarities(detail_only_top_k=0)

        assert [similarities[seq] for seq in range(10, 26)] == joined.scores.tolist()

    def test_a_view_counts_by_the_reading_in_which_it_stands_out_more(self) -> None:
        together, alone = self.similarities(detail_only_top_k=0), self.similarities(detail_only_top_k=4)

        assert all(alone[seq] >= together[seq] for seq in together)
        assert all(alone[seq] > together[seq] + 0.1 for seq in (13, 17))

    def test_in_full_only_the_first_are_read_alone(self) -> None:
        together, one, four = (
            {candidate.seq: candidate.parts["dense_full"] for candidate in self.ranked(detail_only_top_k=count)}
            for count in (0, 1, 4)
        )

        assert one[13] == four[13] > together[13] > 0
        assert four[17] > one[17] == together[17] > 0
        assert all(len([part for part in parts.values() if part > 0]) == 4 for parts in (together, one, four))

    def test_a_recipe_whose_cells_have_no_detail_leaves_it_out(self) -> None:
        weights = {SEMANTIC: 1.0}
        recipe = made_with(SEMANTIC, DETAIL, dense=CellGrid(rows=ROWS, columns=COLUMNS, channel_weights=weights))
        together, alone = (
            ranked(changed(detail_only_top_k=count), views=self.views(), recipe=recipe, candidates=self.FOUND)
            for count in (0, 4)
        )

        assert [(c.seq, c.score, c.parts) for c in together] == [(c.seq, c.score, c.parts) for c in alone]


class TestVerification:
    def test_a_query_without_local_features_is_not_verified(self) -> None:
        views = enrolled()

        ranking = ranked(query=replace(QUERY, keypoints=None), views=views)

        assert [what for what, _ in views.fetched] == ["appearances", "cells"]
        assert all(candidate.verified is None and "verification" not in candidate.parts for candidate in ranking)
        assert seqs(ranking) == NEAREST_FIRST

    def test_nor_is_one_of_a_map_that_verifies_none(self) -> None:
        views = enrolled()

        ranking = ranked(changed(verified_top_k=0), views=views)

        assert [what for what, _ in views.fetched] == ["appearances", "cells"]
        assert all(candidate.verified is None and "verification" not in candidate.parts for candidate in ranking)

    def test_more_than_candidates_are_all_of_them(self) -> None:
        views = enrolled()

        ranking = ranked(changed(verified_top_k=100), views=views)

        assert sorted(views.fetched[2][1]) == sorted(views.views)
        assert all(candidate.verified is not None for candidate in ranking)

    def test_as_many_others_are_verified_however_many_views_the_first_place_has(self) -> None:
        """So that what inliers are measured by stays what it is."""
        views = enrolled((0.0, 0.1, 0.1, 0.1, 0.3, 0.35, 0.4, 0.6, 0.9, 1.3, 2.0, 3.0))
        views.attributes = {seq: KnownView("home" if seq < 14 else f"other {seq}") for seq in views.views}
        equal = found({SEMANTIC: [0.5] * 12, DETAIL: [0.5] * 12})

        ranking = ranked(changed(verified_top_k=6), views=views, candidates=equal)

        others = [one.seq for one in ranking if one.verified and one.seq >= 14]
        assert sorted(others) == [14, 15, 16, 17, 18]

    def test_inliers_count_as_far_as_they_exceed_those_of_the_others(self) -> None:
        ranking = ranked(changed(verified_top_k=3))

        inliers = [candidate.verified.inliers for candidate in ranking[:3] if candidate.verified is not None]
        usual = sorted(inliers)[1]
        assert inliers[0] == 40
        excess = max(0, inliers[0] - usual - 8)
        weights = WEIGHTS.terms()
        share = weights["verification"] / sum(weights.values())
        assert ranking[0].parts["verification"] == pytest.approx(share * excess / (excess + usual + 20))


class TestRivals:
    """Forty views, of which thirty-six show one place: more than are re-ranked."""

    FOUND = found({SEMANTIC: np.linspace(0.2, 0.9, 40).tolist(), DETAIL: np.linspace(0.2, 0.9, 40).tolist()})

    def ranking(self, candidates: int, home: int = 36, **values: Any) -> Ranking:
        views = Dictionary({seq: described(seq, 0.4) for seq in range(10, 50)})
        views.attributes = {seq: KnownView("home" if seq < 10 + home else f"other {seq}") for seq in views.views}
        return rank(QUERY, self.FOUND, RECIPE, changed(candidates=candidates, **values), views, top=10)

    def test_views_that_were_not_compared_do_not_vouch_for_the_first_place(self) -> None:
        """There is no other place among what was compared, so nobody knows what the next one gets."""
        filled = self.ranking(10, home=20)
        assert (filled.reranked, filled.rivals, filled.others) == (10, (), 0)
        one = self.ranking(1, home=1)
        assert (one.reranked, one.rivals, one.others) == (1, (), 0)
        assert self.ranking(22, home=20).others == 2
        assert self.ranking(23, home=20).others == ENOUGH_PLACES

    def test_so_many_as_there_are_are_compared_in_full(self) -> None:
        """Of three compared in full only the first is of its own place, as the decision needs the others."""
        compared: list[int] = []

        def observe(stage: str, evidence: Evidence) -> None:
            if stage == "full":
                compared.extend(sorted(evidence.seqs(np.array(sorted(evidence.cells)))))

        views = Dictionary({seq: described(seq, 0.4 if seq < 20 else 3.0) for seq in range(10, 50)})
        views.attributes = {seq: KnownView("home" if seq < 20 else f"other {seq}") for seq in views.views}
        rank(QUERY, self.FOUND, RECIPE, changed(candidates=40), views, top=10, observe=observe)
        assert [seq < 20 for seq in compared] == [True, False, False]
