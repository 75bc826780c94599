"""Context graphs: regions, centroids, correspondences, edges and the similarity, with all their edge cases."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from schemas.description import ContextGraph
from worker.description.describer import components
from worker.method import context_graph

SQUARE = (1.0, 1.0)


def embeddings_of(labels: np.ndarray) -> np.ndarray:
    """Embeddings (row, column, 1), so that tests see which cell was read."""
    rows, columns = labels.shape
    y, x = np.mgrid[:rows, :columns]
    return np.stack([y, x, np.ones_like(y)], axis=-1).astype(np.float32)


def graph_of(image: list[str], min_region_cells: int = 1, dynamic: str = "") -> ContextGraph:
    labels = np.array([[int(c) for c in row] for row in image], np.int16)
    static = ~np.isin(labels, [int(c) for c in dynamic])
    return context_graph.build(labels, static, embeddings_of(labels), SQUARE, components, min_region_cells)


def test_every_region_of_a_label_is_a_node_at_its_centroid() -> None:
    graph = graph_of(["0011", "0011", "0001", "1000"])
    assert graph.labels.tolist() == [0, 1, 1]
    np.testing.assert_allclose(graph.positions[2], [0.5 / 4, 3.5 / 4])
    np.testing.assert_allclose(graph.shares, [10 / 16, 5 / 16, 1 / 16])


def test_cells_that_touch_at_a_corner_are_one_region() -> None:
    assert graph_of(["10", "01"]).labels.tolist() == [0, 1]


def test_dynamic_cells_are_in_no_region_and_can_part_one() -> None:
    graph = graph_of(["020", "020", "020"], dynamic="2")
    assert graph.labels.tolist() == [0, 0]


def test_specks_below_the_minimum_are_no_nodes() -> None:
    assert graph_of(["000", "010", "000"], min_region_cells=2).labels.tolist() == [0]


def test_the_centroid_of_a_ring_lies_outside_it_and_reads_the_nearest_cell() -> None:
    graph = graph_of(["111", "101", "111"])
    ring = graph.labels.tolist().index(1)
    np.testing.assert_allclose(graph.positions[ring], [0.5, 0.5])
    # (0, 1), (1, 0), (1, 2) and (2, 1) are equally near: the lowest row wins.
    assert graph.embeddings[ring].tolist() == [0, 1, 1]


def test_a_centroid_between_cells_stays_there_and_reads_the_lower_column() -> None:
    graph = graph_of(["11"])
    np.testing.assert_allclose(graph.positions[0], [0.5, 0.5])
    assert graph.embeddings[0].tolist() == [0, 0, 1]


def test_nodes_are_ordered_by_label_then_first_cell() -> None:
    graph = graph_of(["2101", "0000", "1002"])
    first_cells = [(0, 1), (0, 3), (2, 0)]
    assert graph.labels.tolist() == [0, 1, 1, 1, 2, 2]
    ones = graph.positions[graph.labels == 1]
    np.testing.assert_allclose(ones * [4, 3] - 0.5, [[x, y] for y, x in first_cells], atol=1e-5)


def test_an_image_without_static_cells_has_no_nodes() -> None:
    graph = graph_of(["22", "22"], dynamic="2")
    assert len(graph) == 0


def test_positions_are_fractions_of_the_longer_side() -> None:
    labels = np.zeros((2, 4), np.int16)
    graph = context_graph.build(labels, labels == 0, embeddings_of(labels), (1.0, 0.5), components)
    np.testing.assert_allclose(graph.positions, [[0.5, 0.25]])


def hand_graph(labels: list[int], positions: list[tuple[float, float]], vectors: list[list[float]]) -> ContextGraph:
    return ContextGraph(
        np.array(labels, np.int16),
        np.array(positions, np.float32).reshape(-1, 2),
        np.array(vectors, np.float32).reshape(len(labels), 3),
        np.full(len(labels), 0.1, np.float32),
    )


A, B, C = [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]


def test_the_similarity_worked_out_by_hand() -> None:
    query = hand_graph([0, 0, 1, 2], [(0, 0), (0.1, 0), (0, 0.1), (0.9, 0.9)], [A, B, C, A])
    view = hand_graph([0, 0, 1], [(0.5, 0), (0.6, 0), (0.5, 0.4)], [A, B, C])

    found = context_graph.compare(query, [view], cosine=0.95, tau=0.2)

    # Three pairs of 4 + 3 nodes: J_nodes = 3/4. Query edges: 01, 02, 12; the view's: 01. J_edges = 1/3.
    np.testing.assert_allclose(found.similarity, [3 / 4 * (1 + 1 / 3) / 2])
    assert found.matched.tolist() == [[0, 1, 2, -1]]
    assert found.edges_agreeing.tolist() == [1]


def test_a_correspondence_needs_the_same_label_and_a_cosine_above_t() -> None:
    query = hand_graph([0], [(0, 0)], [A])
    other_label = hand_graph([1], [(0, 0)], [A])
    just_t = hand_graph([0], [(0, 0)], [[0.5, np.sqrt(0.75), 0]])

    similarity = context_graph.compare(query, [other_label, just_t], cosine=0.5, tau=1).similarity

    assert similarity.tolist() == [0, 0]  # "greater", not "at least"


def test_only_mutual_best_pairs_count_and_ties_go_to_the_lowest_index() -> None:
    query = hand_graph([0, 0], [(0, 0), (1, 0)], [A, A])
    view = hand_graph([0], [(0, 0)], [A])
    found = context_graph.compare(query, [view], cosine=0.9, tau=0.1)
    assert found.matched.tolist() == [[0, -1]]
    np.testing.assert_allclose(found.similarity, [1 / 2 * 1 / 2])


def test_one_keypoint_each_scores_half_of_the_nodes() -> None:
    one = hand_graph([0], [(0, 0)], [A])
    assert context_graph.compare(one, [one], cosine=0.9, tau=0.1).similarity.tolist() == [0.5]


def test_two_matched_nodes_far_apart_in_both_agree_on_having_no_edge() -> None:
    graph = hand_graph([0, 1], [(0, 0), (1, 1)], [A, B])
    assert context_graph.compare(graph, [graph], cosine=0.9, tau=0.1).similarity.tolist() == [1.0]


@pytest.mark.parametrize("sides", [(0, 0), (0, 2), (2, 0)])
def test_a_side_without_keypoints_scores_zero(sides: tuple[int, int]) -> None:
    query, view = (hand_graph([0] * n, [(0.0, 0.1 * i) for i in range(n)], [A] * n) for n in sides)
    found = context_graph.compare(query, [view], cosine=0.9, tau=0.1)
    assert found.similarity.tolist() == [0]
    assert found.matched.shape == (1, sides[0])


def test_a_mirrored_or_shifted_scene_scores_the_same() -> None:
    positions = np.array([(0.1, 0.1), (0.3, 0.2), (0.5, 0.6)])
    query = hand_graph([0, 1, 2], positions.tolist(), [A, B, C])
    mirrored = hand_graph([0, 1, 2], (positions * [-1, 1] + [0.7, 0.2]).tolist(), [A, B, C])
    assert context_graph.compare(query, [mirrored], cosine=0.9, tau=0.3).similarity.tolist() == [1.0]


@st.composite
def graphs(draw: st.DrawFn) -> ContextGraph:
    n = draw(st.integers(0, 7))
    labels = sorted(draw(st.lists(st.integers(0, 2), min_size=n, max_size=n)))
    random = np.random.default_rng(draw(st.integers(0, 10**6)))
    return hand_graph(labels, random.random((n, 2)).tolist(), random.normal(size=(n, 3)).tolist())


def naive(query: ContextGraph, view: ContextGraph, t: float, tau: float) -> float:
    """The similarity by its definition, one pair at a time."""

    def cosine(p: int, r: int) -> float:
        if query.labels[p] != view.labels[r]:
            return -np.inf
        a, b = query.embeddings[p].astype(np.float64), view.embeddings[r].astype(np.float64)
        return float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))

    if len(query) == 0 or len(view) == 0:
        return 0.0
    table = np.array([[cosine(p, r) for r in range(len(view))] for p in range(len(query))])
    pairs = [
        (p, r)
        for p in range(len(query))
        for r in range(len(view))
        if table[p, r] > t and table[p].argmax() == r and table[:, r].argmax() == p
    ]
    common = either = 0
    for i, (p, r) in enumerate(pairs):
        for p2, r2 in pairs[i + 1 :]:
            in_query = bool(np.linalg.norm(query.positions[p] - query.positions[p2]) <= tau)
            in_view = bool(np.linalg.norm(view.positions[r] - view.positions[r2]) <= tau)
            common += in_query and in_view
            either += in_query or in_view
    m = len(pairs)
    edges = 0.0 if m < 2 else 1.0 if either == 0 else common / either
    return m / (len(query) + len(view) - m) * (1 + edges) / 2


@given(
    graphs(), st.lists(graphs(), min_size=1, max_size=4), st.sampled_from([0.0, 0.5, 0.9]), st.sampled_from([0.2, 0.5])
)
def test_comparing_many_at_once_equals_the_definition(
    query: ContextGraph, views: list[ContextGraph], t: float, tau: float
) -> None:
    together = context_graph.compare(query, views, t, tau).similarity
    np.testing.assert_allclose(together, [naive(query, view, t, tau) for view in views], atol=1e-6)


@given(graphs(), graphs())
def test_the_similarity_is_symmetric_and_within_bounds(one: ContextGraph, other: ContextGraph) -> None:
    forth = context_graph.compare(one, [other], 0.3, 0.4)
    back = context_graph.compare(other, [one], 0.3, 0.4)
    np.testing.assert_allclose(forth.similarity, back.similarity, atol=1e-6)
    assert 0 <= forth.similarity[0] <= 1
    if (forth.matched >= 0).sum() <= 1:
        assert forth.similarity[0] <= 0.5


@given(graphs())
def test_a_graph_has_similarity_1_with_itself(graph: ContextGraph) -> None:
    if len(graph) >= 2:
        assert context_graph.compare(graph, [graph], 0.95, 0.3).similarity[0] == 1.0


def test_thousands_of_specks_are_compared_in_portions_with_the_same_result(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(0)

    def specks(count: int) -> ContextGraph:
        vectors = random.normal(size=(count, 3)).tolist()
        return hand_graph(sorted(random.integers(0, 3, count).tolist()), random.random((count, 2)).tolist(), vectors)

    query, views = specks(40), [specks(30) for _ in range(7)]
    at_once = context_graph.compare(query, views, 0.5, 0.3)
    monkeypatch.setattr(context_graph, "TOGETHER", 2 * 40 * 30)
    in_portions = context_graph.compare(query, views, 0.5, 0.3)

    np.testing.assert_array_equal(at_once.similarity, in_portions.similarity)
    np.testing.assert_array_equal(at_once.matched, in_portions.matched)
    np.testing.assert_array_equal(at_once.edges_agreeing, in_portions.edges_agreeing)
