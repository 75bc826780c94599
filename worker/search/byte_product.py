"""Inner products of int8 vectors (dense cells, descriptors), by the faster method on this processor."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from schemas.description import Floats, Int8s
from schemas.errors import SetupError
from schemas.settings import Settings
from worker.encoders.compact.onnx import open_session
from worker.method.byte_vectors import Numbers, Product, float_product

GRAPH = Path(__file__).with_name("byte_product.onnx")
"""ONNX's MatMulInteger, as `training.commands.export_byte_product` writes it."""

CELLS, DIMENSIONS = 448, 64
"""Shape of the trial: that of a comparison at full resolution."""

TRIALS = 5

_SIGN = np.uint8(128)
"""What makes an int8 the uint8 that is 128 more: the bit of its sign the other way round."""


def make_product(settings: Settings) -> Product:
    """The product of int8 vectors: the faster; float32 for `color`, which does not load ONNX Runtime."""
    return float_product if settings.encoder == "color" else fastest_product()


def fastest_product() -> Product:
    """ONNX Runtime's product of bytes where it is faster (processors with instructions for it), float32 otherwise.

    Both give the same integers, so a trial of a few milliseconds may decide.
    """
    try:
        of_bytes = byte_product()
        if not is_exact(of_bytes):
            return float_product
    except (SetupError, RuntimeError):  # this ONNX Runtime lacks the product
        return float_product
    cells = _trial()
    return min((of_bytes, float_product), key=lambda product: _seconds(lambda: product(cells, cells)))


def is_exact(product: Product) -> bool:
    """Whether the largest are right: without instructions for bytes, sums of two products may saturate at 16 bits."""
    cells = _trial()
    return np.array_equal(product(cells, cells), float_product(cells, cells))


def byte_product() -> Product:
    """ONNX Runtime's product of bytes, in the caller's thread alone; raises SetupError where there is none."""
    session = open_session(GRAPH, threads=1)

    def product(left: Int8s | Floats, right: Int8s | Floats) -> Numbers:
        """Inner products of int8 rows as int32, shape (left rows, right rows)."""
        products: Numbers = session.run(None, {"left": left.view(np.uint8) ^ _SIGN, "right": right})[0]
        return products

    return product


def _trial() -> Int8s:
    """Vectors with the largest products among them, int8 of shape (cells, dimensions)."""
    cells = np.random.default_rng(0).integers(-127, 128, (CELLS, DIMENSIONS), np.int8)
    cells[0], cells[1] = 127, -127
    return cells


def _seconds(work: Callable[[], object]) -> float:
    """Shortest of `TRIALS` times, in seconds."""
    took = []
    for _ in range(TRIALS):
        began = time.perf_counter()
        work()
        took.append(time.perf_counter() - began)
    return min(took)
