"""What every index promises: exact, filtered inside the search, in enrolment order where distances tie."""

from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from schemas.records import Changes, Selection
from worker.search.flat_index import FlatIndex
from worker.search.ports import SAMPLE, Index

DIMENSIONS = {"semantic": 3, "detail": 2}
EVERYTHING = Selection(None, np.zeros(0, np.int64))
NOBODY = np.zeros(0, np.int64)


def changes(revision: int, seqs: list[int], vectors: np.ndarray, gone: list[int] | None = None) -> Changes:
    return Changes(revision, "r", np.array(seqs, np.int64), vectors.astype(np.float32), np.array(gone or [], np.int64))


def filled(count: int, seed: int = 0) -> tuple[Index, np.ndarray]:
    vectors = np.random.default_rng(seed).normal(size=(count, 5)).astype(np.float32)
    index: Index = FlatIndex(DIMENSIONS, "r")
    index.apply(changes(1, list(range(10, 10 + count)), vectors))
    return index, vectors


def split(vector: np.ndarray) -> Mapping[str, np.ndarray]:
    return {"semantic": vector[:3], "detail": vector[3:]}


def nearest(index: Index, vector: np.ndarray, channel: str, count: int, selection: Selection = EVERYTHING) -> list[int]:
    found = index.search(split(vector), count, selection)
    ranked = sorted((rank, int(seq)) for rank, seq in zip(found.ranks[channel], found.seqs, strict=True) if rank)
    return [seq for _, seq in ranked]


def test_each_channel_finds_its_nearest_and_the_union_has_all_distances() -> None:
    index, vectors = filled(50)
    query = np.array([0.1, -0.2, 0.3, 0.5, -0.5], np.float32)

    found = index.search(split(query), 4, EVERYTHING)

    semantic = np.linalg.norm(vectors[:, :3] - query[:3], axis=1)
    detail = np.linalg.norm(vectors[:, 3:] - query[3:], axis=1)
    assert nearest(index, query, "semantic", 4) == (np.argsort(semantic)[:4] + 10).tolist()
    assert nearest(index, query, "detail", 4) == (np.argsort(detail)[:4] + 10).tolist()
    np.testing.assert_allclose(found.distances["semantic"], semantic[found.seqs - 10], rtol=1e-5)
    np.testing.assert_allclose(found.distances["detail"], detail[found.seqs - 10], rtol=1e-5)
    assert found.searched == 50
    assert found.seqs.tolist() == sorted(found.seqs.tolist())


def test_equal_vectors_come_in_enrolment_order_even_across_the_edge() -> None:
    index: Index = FlatIndex(DIMENSIONS, "r")
    index.apply(changes(1, [1, 2, 3, 4, 5, 6], np.ones((6, 5))))
    assert nearest(index, np.ones(5, np.float32), "semantic", 3) == [1, 2, 3]


def test_an_empty_index_answers_with_nothing() -> None:
    index: Index = FlatIndex(DIMENSIONS, "r")
    found = index.search(split(np.ones(5, np.float32)), 5, EVERYTHING)
    assert (len(found.seqs), found.searched) == (0, 0)


def test_asking_for_more_than_there_is_gives_what_there_is() -> None:
    index, vectors = filled(3)
    assert sorted(nearest(index, vectors[0], "semantic", 100)) == [10, 11, 12]


@given(st.sets(st.integers(5, 45)), st.sets(st.integers(5, 45)), st.integers(1, 12))
def test_a_filter_is_exact_and_the_answer_is_filled_whenever_enough_fit(
    only: set[int], never: set[int], count: int
) -> None:
    index, vectors = filled(30)
    selection = Selection(np.array(sorted(only), np.int64), np.array(sorted(never), np.int64))
    allowed = [s for s in range(10, 40) if s in only and s not in never]

    found = nearest(index, vectors[7], "semantic", count, selection)

    by_distance = sorted(allowed, key=lambda s: (np.linalg.norm(vectors[s - 10, :3] - vectors[7, :3]), s))
    assert found == by_distance[:count]
    assert index.search(split(vectors[7]), count, selection).searched == len(allowed)


def test_a_view_described_anew_is_found_by_its_new_vector_only() -> None:
    index, vectors = filled(20)
    index.apply(changes(2, [15], np.full((1, 5), 9.0)))
    assert nearest(index, np.full(5, 9.0, np.float32), "semantic", 1) == [15]
    assert nearest(index, vectors[5], "semantic", 1) != [15]
    assert len(index) == 20


class Following(RuleBasedStateMachine):
    """An index that follows changes in any order always equals a dictionary that does."""

    def __init__(self) -> None:
        super().__init__()
        self.index: Index = FlatIndex(DIMENSIONS, "r")
        self.model: dict[int, np.ndarray] = {}
        self.revision = 0

    @rule(
        seqs=st.sets(st.integers(1, 40), max_size=6),
        gone=st.sets(st.integers(1, 40), max_size=4),
        seed=st.integers(0, 99),
    )
    def change(self, seqs: set[int], gone: set[int], seed: int) -> None:
        self.revision += 1
        gone -= seqs
        vectors = np.random.default_rng(seed).normal(size=(len(seqs), 5)).astype(np.float32)
        self.index.apply(changes(self.revision, sorted(seqs), vectors, sorted(gone)))
        self.model.update(zip(sorted(seqs), vectors, strict=True))
        for seq in gone:
            self.model.pop(seq, None)

    @invariant()
    def same(self) -> None:
        query = np.array([0.3, 0.1, -0.4, 0.2, 0.7], np.float32)
        assert len(self.index) == len(self.model)
        assert self.index.revision == self.revision
        wanted = sorted(self.model, key=lambda s: (round(float(np.linalg.norm(self.model[s][:3] - query[:3])), 6), s))
        assert nearest(self.index, query, "semantic", 5) == wanted[:5]


TestFollowing = Following.TestCase


@pytest.mark.parametrize("dtype", [np.int64])
def test_nothing_selected_is_nothing_found(dtype: type) -> None:
    index, vectors = filled(5)
    assert nearest(index, vectors[0], "semantic", 3, Selection(np.zeros(0, dtype), NOBODY)) == []


def test_a_sample_is_of_all_views_and_the_same_however_they_came() -> None:
    vectors = np.zeros((500, 5), np.float32)
    seqs = np.random.default_rng(3).permutation(np.arange(10, 510)).tolist()
    at_once, in_parts = FlatIndex(DIMENSIONS, "r"), FlatIndex(DIMENSIONS, "r")
    assert at_once.sample() == ()
    at_once.apply(changes(1, sorted(seqs), vectors))
    for revision, start in enumerate(range(0, 500, 125), 1):
        part = sorted(seqs[start : start + 125])
        in_parts.apply(changes(revision, part, vectors[:125]))
        assert len(in_parts.sample()) == SAMPLE
        assert set(in_parts.sample()) <= set(seqs[: start + 125])

    sample = at_once.sample()
    assert in_parts.sample() == sample == tuple(sorted(sample))
    assert len({(seq - 10) * 4 // 500 for seq in sample}) == 4  # from each quarter of the map
    at_once.apply(changes(9, [], vectors[:0], gone=list(sample[:3])))
    assert set(sample[3:]) < set(at_once.sample())
    few, _ = filled(5)
    assert few.sample() == (10, 11, 12, 13, 14)
