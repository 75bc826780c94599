"""Similarities by all channels joined and by one channel alone, and their fusion."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from schemas.description import Floats
from worker.method import channel_fusion, dense_cells
from worker.method.byte_vectors import quantise

SHARES = {"semantic": 0.35, "detail": 0.65}


def cells(seed: int, dimensions: int = 16) -> Floats:
    drawn = np.random.default_rng(seed).normal(size=(8, 12, dimensions)).astype(np.float32)
    unit: Floats = drawn / np.linalg.norm(drawn, axis=2, keepdims=True)
    return unit


def test_a_channel_sliced_from_joined_cells_compares_as_it_would_by_itself() -> None:
    query, view = ({"semantic": cells(seed), "detail": cells(seed + 1)} for seed in (0, 2))
    view["detail"] = np.roll(query["detail"], 1, axis=1) * 0.8 + view["detail"] * 0.6
    view["detail"] /= np.linalg.norm(view["detail"], axis=2, keepdims=True)
    ours, theirs = (quantise(dense_cells.join(image, SHARES)) for image in (query, view))

    mine = channel_fusion.slice_channel(ours, SHARES, "detail")
    cut = channel_fusion.single_channel_agreement(ours, theirs[None], SHARES, "detail").scores

    alone = dense_cells.compare(query["detail"], view["detail"][None])
    assert channel_fusion.length(mine) == pytest.approx(np.sqrt(0.65), rel=0.01)
    assert cut == pytest.approx(alone.scores, abs=0.01)
    words = channel_fusion.slice_channel(ours, SHARES, "semantic")
    np.testing.assert_array_equal(np.concatenate([mine, words], axis=-1), ours)


def test_at_half_size_a_sliced_channel_is_shorter_and_its_similarities_are_those_of_the_channel_by_itself() -> None:
    """Four neighbours have the same semantic part and unlike details, which nearly cancel in their average."""
    words = np.repeat(np.repeat(cells(0)[::2, ::2], 2, axis=0), 2, axis=1)
    joined = {"semantic": words, "detail": cells(1)}
    whole = quantise(dense_cells.join(joined, SHARES))
    half = quantise(dense_cells.halve(whole))

    mine = channel_fusion.slice_channel(half, SHARES, "detail")

    assert channel_fusion.length(mine) < np.sqrt(0.65) - 0.1
    assert channel_fusion.single_channel_agreement(half, half[None], SHARES, "detail").scores == pytest.approx(
        [1.0], abs=0.15
    )
    assert channel_fusion.length(np.zeros((2, 3, 4), np.int8)) == 1


def test_scales_are_aligned_so_that_most_candidates_get_the_same_similarity() -> None:
    joined = np.array([0.2] * 9 + [0.3], np.float32)
    alone = np.array([0.1] * 9 + [0.4], np.float32)

    rate = channel_fusion.align_scale(joined, alone)

    assert rate == pytest.approx(2)
    # The last candidate stands out more by the detail channel alone.
    assert channel_fusion.max_fusion(joined, alone, rate).tolist() == pytest.approx([0.2] * 9 + [0.8])
    assert channel_fusion.align_scale(joined, np.zeros(10, np.float32)) == 0


def test_small_similarities_in_an_image_without_content_are_not_scaled_up_without_bound() -> None:
    joined = np.full(40, 0.2, np.float32)
    alone = np.array([0.0] * 33 + [1e-20] * 6 + [0.05], np.float32)

    assert channel_fusion.max_fusion(joined, alone, channel_fusion.align_scale(joined, alone)) == pytest.approx(joined)


def test_the_only_candidate_is_not_raised_by_the_detail_channel() -> None:
    joined, alone = np.array([0.2], np.float32), np.array([0.7], np.float32)
    assert channel_fusion.max_fusion(joined, alone, channel_fusion.align_scale(joined, alone)) == pytest.approx([0.2])


Similarities = st.lists(st.floats(0, 1, width=32), min_size=1, max_size=20)


@given(Similarities, Similarities, st.floats(0, 8))
def test_max_fusion_lowers_nothing_and_leaves_candidates_without_a_second_similarity(
    joined: list[float], alone: list[float], rate: float
) -> None:
    alone = alone[: len(joined)]

    merged = channel_fusion.max_fusion(np.array(joined, np.float32), np.array(alone, np.float32), rate)

    assert merged.dtype == np.float32
    assert ((merged >= np.array(joined, np.float32)) & (merged <= 1)).all()
    assert merged[len(alone) :].tolist() == joined[len(alone) :]
