"""The cells that decided: they make the score that the ranking uses, and tell two candidates apart."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from schemas.description import DETAIL, SEMANTIC, Int8s
from tests.method.views_in_a_dictionary import (
    COLUMNS,
    DIMENSIONS,
    NOISES,
    QUERY,
    RECIPE,
    ROWS,
    changed,
    described,
    enrolled,
    ranked,
)
from worker.description.describer import components
from worker.method import cell_evidence, dense_cells, hough
from worker.method.byte_vectors import quantise
from worker.method.cell_evidence import CellEvidence
from worker.method.evidence import Evidence

CHANNELS = (SEMANTIC, DETAIL)
VIEWS = {seq: described(seq, noise) for seq, noise in enumerate(NOISES, start=10)}


def cells(seed: int, rows: int = 8, columns: int = 12, dimensions: int = 16) -> Int8s:
    drawn = np.random.default_rng(seed).normal(size=(rows, columns, dimensions)).astype(np.float32)
    return quantise(drawn / np.linalg.norm(drawn, axis=2, keepdims=True))


def evidence_of(weights: dict[tuple[int, int], float], shape: tuple[int, int] = (6, 8)) -> CellEvidence:
    """Evidence in which these cells (row, column) of the query have these weights."""
    at = np.array(sorted(row * shape[1] + column for row, column in weights), np.intp)
    weight = np.array([weights[divmod(int(cell), shape[1])] for cell in at])
    return CellEvidence(shape, at, at, weight)


class TestAgreeing:
    @settings(max_examples=25, deadline=None)
    @given(st.integers(0, 10_000), st.sampled_from([(1.0, 1.0), (1.0, 1.5), (0.5, 1.0)]))
    def test_the_weights_sum_to_what_the_similarity_is_the_root_of(
        self, seed: int, aspect: tuple[float, float]
    ) -> None:
        query, candidate = cells(seed), cells(seed + 1)
        candidate[2:6, 3:9] = query[3:7, 2:8]
        shape = np.array(aspect)
        compared = dense_cells.compare(query, candidate[None], cell_aspect=shape[None])

        found = cell_evidence.agreeing(query, candidate, CHANNELS, cell_aspect=shape)

        assert found.weight.sum() == pytest.approx(float(compared.scores[0]) ** 2, abs=1e-6)
        assert found.similarity == pytest.approx(float(compared.scores[0]), abs=1e-6)
        assert compared.cells[0] == pytest.approx(found.of_query().ravel(), abs=1e-6)
        assert (found.weight > 0).all()
        assert len(set(found.query_cell.tolist())) == len(set(found.candidate_cell.tolist())) == len(found.weight)

    def test_they_are_the_cells_that_moved_together(self) -> None:
        query, candidate = cells(1), cells(2)
        candidate[2:6, 3:9] = query[3:7, 2:8]  # one row up, one column to the right

        found = cell_evidence.agreeing(query, candidate, CHANNELS)

        moved = {(row, column) for row in range(3, 7) for column in range(2, 8)}
        pairs = {
            divmod(int(one), 12): divmod(int(other), 12)
            for one, other in zip(found.query_cell, found.candidate_cell, strict=True)
        }
        assert moved <= pairs.keys()
        assert all(pairs[row, column] == (row - 1, column + 1) for row, column in moved)
        assert found.of_query()[3:7, 2:8].sum() > 0.8 * found.weight.sum()
        assert found.of_candidate()[2:6, 3:9].sum() == pytest.approx(found.of_query()[3:7, 2:8].sum())

    def test_an_image_of_nothing_has_no_evidence(self) -> None:
        nothing = np.zeros((4, 5, 8), np.int8)

        found = cell_evidence.agreeing(nothing, nothing, CHANNELS, align_scale=1.2)

        assert (len(found.weight), found.similarity, found.of_query().shape) == (0, 0.0, (4, 5))

    @pytest.mark.parametrize("some", [0, 2, 3])
    def test_they_make_the_term_of_the_ranking_in_the_comparison_that_counted(self, some: int) -> None:
        terms: dict[int, float] = {}

        def observe(stage: str, evidence: Evidence) -> None:
            if stage == "full":
                rows = np.flatnonzero(evidence.terms["dense_full"])
                terms.update(zip(evidence.seqs(rows), evidence.terms["dense_full"][rows].tolist(), strict=True))

        views = enrolled()
        # One view whose detail is the query's own, whatever its semantics: there detail alone is larger.
        views.views[13] = described(13, 1.0, detail=0.0)
        ranking = ranked(changed(detail_only_top_k=some), views=views, observe=observe)

        compared = [one for one in ranking if one.seq in terms]
        assert len(compared) == 3
        channels = set()
        for one in compared:
            assert one.dense is not None
            found = cell_evidence.agreeing(
                QUERY.cells, views.views[one.seq].cells, RECIPE.parameters.cell_channels(),
                align_scale=one.dense.align_scale,
            )  # fmt: skip
            assert found.similarity == pytest.approx(terms[one.seq], abs=1e-5)
            channels.add(found.channel)
        assert channels == ({None} if some == 0 else {None, DETAIL})
        by_detail = [one.dense.align_scale > 0 for one in compared if one.dense is not None]
        assert sum(by_detail) == some

    def test_detail_alone_counts_only_where_it_is_larger(self) -> None:
        query = QUERY.cells
        view = described(3, 1.0, detail=0.0).cells
        half = slice(0, DIMENSIONS)  # detail comes first by name
        alone = dense_cells.compare(query[..., half], view[None][..., half], length=np.sqrt(0.5)).scores[0]

        joined = cell_evidence.agreeing(query, view, CHANNELS, align_scale=0.0)
        larger = cell_evidence.agreeing(query, view, CHANNELS, align_scale=0.9)
        smaller = cell_evidence.agreeing(query, view, CHANNELS, align_scale=0.1)

        assert (joined.channel, larger.channel, smaller.channel) == (None, DETAIL, None)
        assert larger.similarity == pytest.approx(0.9 * alone, abs=1e-2)
        assert cell_evidence.agreeing(query, view, CHANNELS, align_scale=2.0).similarity == pytest.approx(1)
        assert larger.shape == (ROWS, COLUMNS)

    def test_the_winners_weigh_what_the_hough_vote_found(self) -> None:
        query, candidates = cells(5), np.stack([cells(6), cells(5), cells(7)])
        pairs = dense_cells.correspondences(query, candidates)
        burstiness = dense_cells.burstiness_weight(query)

        won = hough.winning(pairs, burstiness, (8, 12), 3, np.ones((3, 2)))

        summed = np.bincount(pairs.candidate[won.pairs], won.weights, 3)
        np.testing.assert_allclose(summed, won.heights)
        scores = dense_cells.compare(query, candidates).scores
        np.testing.assert_allclose(np.sqrt(won.heights / hough.largest_weight(burstiness)), scores, atol=1e-6)


class TestContrast:
    def test_the_difference_of_each_cell_sums_to_that_of_the_squared_similarities(self) -> None:
        first, rival = (
            cell_evidence.agreeing(QUERY.cells, VIEWS[seq].cells, CHANNELS) for seq in (11, 13)
        )  # fmt: skip

        found = cell_evidence.contrast(first, rival, (1.0, 0.75), components)

        assert found.difference.sum() == pytest.approx(first.similarity**2 - rival.similarity**2)
        np.testing.assert_array_equal(found.difference, first.of_query() - rival.of_query())

    def test_regions_are_named_by_where_they_are_and_whom_they_speak_for(self) -> None:
        first = evidence_of({(r, c): 0.02 for r in (1, 2) for c in (1, 2, 3)} | {(5, 0): 0.001})
        rival = evidence_of({(r, 6): 0.03 for r in (3, 4)})

        found = cell_evidence.contrast(first, rival, (1.0, 0.75), components)

        left, right = found.regions
        assert left.strength == pytest.approx(0.12)
        assert left.centre == pytest.approx((2.5 / 8, 2 / 6 * 0.75))
        assert left.extent == pytest.approx((3 / 8, 2 / 6 * 0.75))
        assert right.strength == pytest.approx(-0.06)
        assert right.centre == pytest.approx((6.5 / 8, 4 / 6 * 0.75))
        assert (found.numbers[1:3, 1:4] == 1).all()
        assert (found.numbers[3:5, 6] == 2).all()
        assert (found.numbers > 0).sum() == 8

    def test_the_strongest_come_first_and_no_more_than_five(self) -> None:
        shape = (6, 12)
        first = evidence_of({(0, 0): 0.01, (0, 4): 0.012, (3, 2): 0.011, (0, 8): 0.013, (3, 6): 0.014}, shape)
        rival = evidence_of({(5, 11): 0.02}, shape)

        found = cell_evidence.contrast(first, rival, (1.0, 0.75), components)

        assert [round(region.strength, 3) for region in found.regions] == [-0.02, 0.014, 0.013, 0.012, 0.011]
        assert set(np.unique(found.numbers)) == {0, 1, 2, 3, 4, 5}

    def test_two_equal_candidates_differ_nowhere(self) -> None:
        same = evidence_of({(1, 1): 0.02, (4, 4): 0.01})

        found = cell_evidence.contrast(same, same, (1.0, 0.75), components)

        assert found.regions == ()
        assert not found.numbers.any()

    def test_changing_sides_changes_signs(self) -> None:
        first, rival = evidence_of({(1, 1): 0.02}), evidence_of({(4, 6): 0.013, (1, 1): 0.001})

        one = cell_evidence.contrast(first, rival, (1.0, 0.75), components)
        other = cell_evidence.contrast(rival, first, (1.0, 0.75), components)

        assert [(r.centre, r.strength) for r in one.regions] == [(r.centre, -r.strength) for r in other.regions]
