"""Inner products of stored dense cells, one byte a component, by the fastest way that this processor has."""

import time
from collections.abc import Callable

import numpy as np

from schemas.description import Floats, Int8s
from worker.method.byte_vectors import Numbers, Product, float_product

CELLS, DIMENSIONS = 448, 64
"""Of the trial: as large as a comparison in full."""

TRIALS = 5


def fastest_product() -> Product:
    """PyTorch's product of bytes where the processor has instructions for it, float32 otherwise.

    Both give the same whole numbers, so that a trial of a few milliseconds may decide.
    """
    cells = np.random.default_rng(0).integers(-64, 65, (CELLS, DIMENSIONS), np.int8)
    try:
        if not np.array_equal(_of_bytes(cells, cells), float_product(cells, cells)):
            return float_product
    except (AttributeError, RuntimeError):  # another version of PyTorch, or one built without it
        return float_product
    return min((_of_bytes, float_product), key=lambda product: _seconds(lambda: product(cells, cells)))


def _of_bytes(left: Int8s | Floats, right: Int8s | Floats) -> Numbers:
    """As `float_product`, for int8 only, as int32."""
    import torch

    if left.shape[1] == 1:  # where PyTorch 2.13 answers with what lies in memory
        return float_product(left, right)
    products: Numbers = torch._int_mm(torch.from_numpy(left), torch.from_numpy(right).T).numpy()
    return products


def _seconds(work: Callable[[], object]) -> float:
    """The least that a piece of work took."""
    took = []
    for _ in range(TRIALS):
        began = time.perf_counter()
        work()
        took.append(time.perf_counter() - began)
    return min(took)
