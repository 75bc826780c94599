"""Products of bytes: however they are made, they are the same whole numbers."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from schemas.description import Floats, Int8s
from schemas.errors import SetupError
from schemas.settings import Settings
from training.commands.export_byte_product import main
from worker.method import dense_cells, vocabulary
from worker.method.byte_vectors import Numbers, float_product, quantise
from worker.method.unit_length import unit
from worker.search import byte_product
from worker.search.byte_product import GRAPH, is_exact, make_product

OF_BYTES = byte_product.byte_product()


@settings(deadline=None)  # a crowded machine is no failure
@given(st.integers(0, 2**16), st.integers(1, 40), st.integers(1, 40), st.sampled_from([1, 2, 31, 64, 1024]))
def test_bytes_and_floats_give_the_same_whole_numbers(seed: int, left: int, right: int, dimensions: int) -> None:
    draw = np.random.default_rng(seed)
    largest = 127 if is_exact(OF_BYTES) else 64
    ours, theirs = (draw.integers(-largest, largest + 1, (n, dimensions), np.int8) for n in (left, right))
    expected = ours.astype(np.int64) @ theirs.astype(np.int64).T
    np.testing.assert_array_equal(OF_BYTES(ours, theirs), expected)
    np.testing.assert_array_equal(float_product(ours, theirs), expected)


def test_the_product_that_is_taken_is_exact_on_this_processor() -> None:
    assert is_exact(byte_product.fastest_product())


def test_a_comparison_does_not_depend_on_the_product() -> None:
    draw = np.random.default_rng(0)
    query, candidates = draw.integers(-30, 30, (6, 8, 16), np.int8), draw.integers(-30, 30, (5, 6, 8, 16), np.int8)
    candidates[2] = query
    floats = dense_cells.compare(query, candidates)
    bytes_ = dense_cells.compare(query, candidates, OF_BYTES)
    np.testing.assert_array_equal(floats.scores, bytes_.scores)
    np.testing.assert_array_equal(floats.shifts, bytes_.shifts)
    np.testing.assert_array_equal(floats.scales, bytes_.scales)


def test_the_histogram_of_an_image_does_not_depend_on_the_product_and_hardly_on_rounding() -> None:
    draw = np.random.default_rng(0)
    words = unit(draw.standard_normal((64, 97)))
    descriptors = unit(words[draw.integers(0, 64, 600)] + 0.12 * draw.standard_normal((600, 97)))
    kept = quantise(descriptors), quantise(words)
    floats = vocabulary.histogram(*kept, 3, 0.05)
    np.testing.assert_array_equal(floats, vocabulary.histogram(*kept, 3, 0.05, OF_BYTES))
    np.testing.assert_allclose(floats, vocabulary.histogram(descriptors, words, 3, 0.05), atol=2e-4)


def test_the_faster_one_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    def slow(left: Int8s | Floats, right: Int8s | Floats) -> Numbers:
        time.sleep(0.02)
        return float_product(left, right)

    monkeypatch.setattr(byte_product, "byte_product", lambda: slow)
    assert make_product(Settings(encoder="compact")) is float_product

    def quick(left: Int8s | Floats, right: Int8s | Floats) -> Numbers:
        return float_product(left, right)

    monkeypatch.setattr(byte_product, "byte_product", lambda: quick)
    monkeypatch.setattr(byte_product, "float_product", slow)
    assert make_product(Settings(encoder="compact")) is quick
    assert make_product(Settings(encoder="color")) is slow


def test_without_a_product_of_bytes_floats_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise SetupError("no such graph")

    monkeypatch.setattr(byte_product, "byte_product", missing)
    assert byte_product.fastest_product() is float_product


def test_a_product_whose_sums_saturate_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processors without instructions for bytes add two products in 16 bits."""

    def saturating(left: Int8s | Floats, right: Int8s | Floats) -> Numbers:
        ours, theirs = left.astype(np.int32) + 128, right.astype(np.int32)
        pairs = [ours[:, at : at + 2] @ theirs[:, at : at + 2].T for at in range(0, left.shape[1], 2)]
        sums = sum(np.clip(pair, -(2**15), 2**15 - 1) for pair in pairs)
        return np.asarray(sums - 128 * theirs.sum(1), np.int32)

    small = np.random.default_rng(0).integers(-64, 65, (9, 64), np.int8)
    np.testing.assert_array_equal(saturating(small, small), float_product(small, small))
    monkeypatch.setattr(byte_product, "byte_product", lambda: saturating)
    assert byte_product.fastest_product() is float_product


def test_the_graph_is_what_the_command_writes(tmp_path: Path) -> None:
    main(["--to", str(tmp_path / "graph.onnx")])
    assert (tmp_path / "graph.onnx").read_bytes() == GRAPH.read_bytes()


ALONE = """
import threading, time
import numpy as np
from worker.search import byte_product

cells = np.ones((2640, 97), np.int8)
shares = []

of_bytes = byte_product.byte_product()

def multiply():
    of_bytes(cells, cells[:512])
    everyone, here = time.process_time(), time.thread_time()
    for _ in range(200):
        of_bytes(cells, cells[:512])
    shares.append((time.process_time() - everyone) / (time.thread_time() - here))

thread = threading.Thread(target=multiply)
thread.start()
thread.join()
print(shares[0])
"""


def test_products_in_any_thread_take_that_thread_alone() -> None:
    environment = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}
    attributes = subprocess.run(
        [sys.executable, "-c", ALONE], env=environment, capture_output=True, text=True, check=True, timeout=120
    )
    assert float(attributes.stdout) < 1.3
