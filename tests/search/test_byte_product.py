"""Products of bytes: however they are made, they are the same whole numbers."""

import os
import subprocess
import sys

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st

from schemas.settings import Settings
from worker.method import dense_cells, vocabulary
from worker.method.byte_vectors import float_product, quantise
from worker.method.unit_length import unit
from worker.search import byte_product
from worker.search.byte_product import make_product


@settings(deadline=None)  # a crowded machine is no failure
@given(st.integers(0, 2**16), st.integers(1, 40), st.integers(1, 40), st.sampled_from([1, 2, 31, 64, 1024]))
def test_bytes_and_floats_give_the_same_whole_numbers(seed: int, left: int, right: int, dimensions: int) -> None:
    draw = np.random.default_rng(seed)
    ours, theirs = (draw.integers(-127, 128, (n, dimensions), np.int8) for n in (left, right))
    expected = ours.astype(np.int64) @ theirs.astype(np.int64).T
    np.testing.assert_array_equal(byte_product._of_bytes(ours, theirs), expected)
    np.testing.assert_array_equal(float_product(ours, theirs), expected)


def test_a_comparison_does_not_depend_on_the_product() -> None:
    draw = np.random.default_rng(0)
    query, candidates = draw.integers(-30, 30, (6, 8, 16), np.int8), draw.integers(-30, 30, (5, 6, 8, 16), np.int8)
    candidates[2] = query
    floats = dense_cells.compare(query, candidates)
    bytes_ = dense_cells.compare(query, candidates, byte_product._of_bytes)
    np.testing.assert_array_equal(floats.scores, bytes_.scores)
    np.testing.assert_array_equal(floats.shifts, bytes_.shifts)
    np.testing.assert_array_equal(floats.scales, bytes_.scales)


def test_the_histogram_of_an_image_does_not_depend_on_the_product_and_hardly_on_rounding() -> None:
    draw = np.random.default_rng(0)
    words = unit(draw.standard_normal((64, 97)))
    descriptors = unit(words[draw.integers(0, 64, 600)] + 0.12 * draw.standard_normal((600, 97)))
    kept = quantise(descriptors), quantise(words)
    floats = vocabulary.histogram(*kept, 3, 0.05)
    np.testing.assert_array_equal(floats, vocabulary.histogram(*kept, 3, 0.05, byte_product._of_bytes))
    np.testing.assert_allclose(floats, vocabulary.histogram(descriptors, words, 3, 0.05), atol=2e-4)


def test_without_a_product_of_bytes_floats_do(monkeypatch: pytest.MonkeyPatch) -> None:
    assert byte_product.fastest_product() in (byte_product._of_bytes, float_product)
    monkeypatch.delattr("torch._int_mm")
    assert byte_product.fastest_product() is float_product


ALONE = """
import threading, time
import numpy as np
from worker.search import byte_product

cells = np.ones((2640, 97), np.int8)
shares = []

def multiply():
    byte_product._of_bytes(cells, cells[:512])
    everyone, here = time.process_time(), time.thread_time()
    for _ in range(200):
        byte_product._of_bytes(cells, cells[:512])
    shares.append((time.process_time() - everyone) / (time.thread_time() - here))

thread = threading.Thread(target=multiply)
thread.start()
thread.join()
print(shares[0])
"""


def test_products_in_any_thread_take_that_thread_alone() -> None:
    """torch.set_num_threads(1) does not see to that: oneDNN asks OpenMP, whose setting is each thread's own."""
    environment = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}
    attributes = subprocess.run(
        [sys.executable, "-c", ALONE], env=environment, capture_output=True, text=True, check=True, timeout=120
    )
    assert float(attributes.stdout) < 1.3


def test_small_products_keep_to_one_thread_beside_the_encoder_in_onnx_runtime() -> None:
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        make_product(Settings(encoder="compact"))
        assert torch.get_num_threads() == 1
    finally:
        torch.set_num_threads(before)
