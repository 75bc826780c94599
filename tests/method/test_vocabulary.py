"""Visual words, histograms, and their training."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from schemas.errors import DescriptorMismatch
from schemas.recipe import Channel
from worker.method import vocabulary
from worker.method.vocabulary import ChannelVocabulary

WORDS = np.array([[1, 0], [0, 1], [-1, 0]], np.float32)


def test_a_histogram_counts_nearest_words() -> None:
    descriptors = np.array([[1, 0], [0.8, 0.6], [0, 1], [-0.6, 0.8]], np.float32)
    assert vocabulary.histogram(descriptors, WORDS).tolist() == [0.5, 0.5, 0]


def test_distance_decides_and_not_the_inner_product() -> None:
    words = np.array([[1, 0], [3, 0]], np.float32)  # (3, 0) has the larger inner product with (1.5, 0)
    assert vocabulary.histogram(np.array([[1.5, 0]], np.float32), words).tolist() == [1, 0]


def test_no_descriptor_gives_zeros_and_not_a_division_by_zero() -> None:
    nothing = np.zeros((0, 2), np.float32)
    assert vocabulary.histogram(nothing, WORDS).tolist() == [0, 0, 0]
    channel = Channel(layer="words", vocabulary_size=3, normalisation="hellinger")
    assert vocabulary.vector(nothing, ChannelVocabulary(WORDS), channel).tolist() == [0, 0, 0]


def test_soft_assignment_shares_by_cosine_over_temperature() -> None:
    descriptor = np.array([[0.8, 0.6]], np.float32)
    counts = vocabulary.histogram(descriptor, WORDS, assignments=2, temperature=0.1)
    first, second = np.exp([0.8 / 0.1, 0.6 / 0.1])
    np.testing.assert_allclose(counts, [first / (first + second), second / (first + second), 0], rtol=1e-5)


def test_another_encoders_vocabulary_is_refused_with_both_sizes() -> None:
    with pytest.raises(DescriptorMismatch, match="2 channels but the vocabulary has 3"):
        vocabulary.histogram(np.zeros((1, 2), np.float32), np.zeros((4, 3), np.float32))


def test_hellinger_takes_the_root_and_has_unit_length() -> None:
    descriptors = np.array([[1, 0], [1, 0], [1, 0], [0, 1]], np.float32)
    channel = Channel(layer="words", vocabulary_size=3, normalisation="hellinger")
    vector = vocabulary.vector(descriptors, ChannelVocabulary(WORDS), channel)
    np.testing.assert_allclose(vector, [np.sqrt(0.75), 0.5, 0], rtol=1e-6)


@given(arrays(np.float32, (12, 2), elements=st.floats(-1, 1, width=32)), st.integers(1, 3), st.permutations(range(12)))
def test_histograms_sum_to_one_and_do_not_depend_on_the_order(
    descriptors: np.ndarray, assignments: int, order: list[int]
) -> None:
    counts = vocabulary.histogram(descriptors, WORDS, assignments)
    shuffled = vocabulary.histogram(descriptors[order], WORDS, assignments)

    assert counts.min() >= 0
    np.testing.assert_allclose(counts.sum(), 1, rtol=1e-5)
    np.testing.assert_allclose(counts, shuffled, atol=1e-6)


def clusters(random: np.random.Generator, centres: np.ndarray, each: int) -> np.ndarray:
    points = np.repeat(centres, each, axis=0) + random.normal(0, 0.02, (len(centres) * each, centres.shape[1]))
    return points.astype(np.float32)


def test_training_finds_the_clusters_that_are_there() -> None:
    centres = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 3]])
    descriptors = clusters(np.random.default_rng(0), centres, 60)

    words = vocabulary.train_words(descriptors, 5, np.random.default_rng(1))

    distances = np.linalg.norm(words[:, None] - centres[None], axis=2)
    assert sorted(distances.argmin(axis=1).tolist()) == [0, 1, 2, 3, 4]
    assert distances.min(axis=1).max() < 0.02


def test_training_is_repeatable_and_spherical_words_have_unit_length() -> None:
    descriptors = clusters(np.random.default_rng(0), np.random.default_rng(2).normal(size=(6, 4)), 20)

    first, second = (vocabulary.train_words(descriptors, 9, np.random.default_rng(7), spherical=True) for _ in range(2))

    assert np.array_equal(first, second)
    np.testing.assert_allclose(np.linalg.norm(first, axis=1), 1, rtol=1e-5)


def test_more_words_than_distinct_descriptors_are_refused() -> None:
    with pytest.raises(ValueError, match="cannot give 3 distinct words"):
        vocabulary.train_words(np.ones((10, 2), np.float32), 3, np.random.default_rng(0))


def test_no_word_is_left_without_descriptors() -> None:
    random = np.random.default_rng(3)
    descriptors = clusters(random, random.normal(size=(8, 3)), 10)
    words = vocabulary.train_words(descriptors, 8, np.random.default_rng(0))
    used = vocabulary.histogram(descriptors, words)
    assert (used > 0).all()


def test_projection_decorrelates_and_half_whitens() -> None:
    random = np.random.default_rng(0)
    histograms = (random.normal(size=(500, 6)) * np.array([8, 4, 2, 1, 1, 1])).astype(np.float32)

    learned = vocabulary.fit_projection(histograms, 3)

    projected = (histograms - learned.mean) @ learned.matrix
    covariance = np.cov(projected.T)
    np.testing.assert_allclose(np.diag(covariance), [8, 4, 2], rtol=0.15)  # s^2 / s: the standard deviations
    np.testing.assert_allclose(covariance - np.diag(np.diag(covariance)), 0, atol=0.05)


def test_too_few_images_for_a_projection_are_refused() -> None:
    with pytest.raises(ValueError, match="4 images of 10 words cannot give 8"):
        vocabulary.fit_projection(np.zeros((4, 10), np.float32), 8)


def test_cell_directions_are_orthonormal_and_keep_what_varies_most() -> None:
    random = np.random.default_rng(0)
    cells = (random.normal(size=(400, 5)) * np.array([1, 5, 1, 3, 1])).astype(np.float32)
    directions = vocabulary.fit_cells(cells, 2)
    np.testing.assert_allclose(directions.T @ directions, np.eye(2), atol=1e-5)
    np.testing.assert_allclose(np.abs(directions[[1, 3], [0, 1]]), 1, atol=0.1)


def test_cells_have_the_requested_number_of_components_even_if_the_layer_has_fewer() -> None:
    cells = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    directions = vocabulary.fit_cells(cells, 5)
    assert directions.shape == (3, 5)
    np.testing.assert_allclose(np.linalg.norm(cells @ directions, axis=1), np.linalg.norm(cells, axis=1), rtol=1e-4)
