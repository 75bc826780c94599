"""Residuals by word, against numbers worked by hand."""

import numpy as np
import pytest

from lab.baselines.vlad import learn_words, vlad

WORDS = np.array([[0, 0], [10, 0]], np.float32)


def test_vlad_by_hand() -> None:
    descriptors = np.array([[1, 2], [2, 2], [9, 0]], np.float32)
    # Word 0 gets (3, 4), at unit length (.6, .8); word 1 gets (-1, 0); both weigh the same.
    expected = np.array([0.6, 0.8, -1, 0]) / np.sqrt(2)
    assert vlad(descriptors, WORDS, signed_roots=False) == pytest.approx(expected)


def test_signed_roots_by_hand() -> None:
    descriptors = np.array([[-9, 16], [10, -4]], np.float32)
    expected = np.array([-3 / 5, 4 / 5, 0, -1]) / np.sqrt(2)
    assert vlad(descriptors, WORDS, signed_roots=True) == pytest.approx(expected)


def test_a_word_that_is_not_met_and_an_image_without_descriptors() -> None:
    alone = vlad(np.array([[0, 5]], np.float32), WORDS, signed_roots=True)
    assert alone == pytest.approx(np.array([0, 1, 0, 0]))
    assert not vlad(np.zeros((0, 2), np.float32), WORDS, signed_roots=True).any()


def test_words_are_the_middles_of_heaps_whatever_the_order_of_the_heaps() -> None:
    random = np.random.default_rng(0)
    heaps = [middle + random.normal(scale=0.1, size=(50, 2)).astype(np.float32) for middle in WORDS]
    words = learn_words(heaps, 2, seed=1)
    assert words[np.argsort(words[:, 0])] == pytest.approx(WORDS, abs=0.1)
    assert np.array_equal(words, learn_words(heaps, 2, seed=1))


def test_fewer_descriptors_than_words() -> None:
    assert learn_words([np.array([[1, 2]], np.float32), np.zeros((0, 2), np.float32)], 64, seed=0).shape == (1, 2)
    assert learn_words([np.zeros((0, 2), np.float32)], 64, seed=0).shape == (1, 2)
