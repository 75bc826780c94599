"""Inner products of int8 vectors (dense cells, descriptors), by the fastest method on this processor."""

import time
from collections.abc import Callable

import numpy as np

from schemas.description import Floats, Int8s
from schemas.settings import Settings
from worker.configure import configure_torch, has_torch
from worker.method.byte_vectors import Numbers, Product, float_product

CELLS, DIMENSIONS = 448, 64
"""Shape of the trial: that of a comparison at full resolution."""

TRIALS = 5


def make_product(settings: Settings) -> Product:
    """The product of int8 vectors: the fastest; float32 without torch, and for `color`, which does not load it."""
    if settings.encoder == "color" or not has_torch():
        return float_product
    if settings.encoder != "lseg" and settings.device == "cpu":
        configure_torch(1)  # nothing but these products runs in torch then: more threads would only spin
    return fastest_product()


def fastest_product() -> Product:
    """PyTorch's int8 product where it is faster (processors with instructions for it), float32 otherwise.

    Both give the same integers, so a trial of a few milliseconds may decide.
    """
    cells = np.random.default_rng(0).integers(-64, 65, (CELLS, DIMENSIONS), np.int8)
    try:
        if not np.array_equal(_of_bytes(cells, cells), float_product(cells, cells)):
            return float_product
    except (AttributeError, RuntimeError):  # this PyTorch lacks the product
        return float_product
    return min((_of_bytes, float_product), key=lambda product: _seconds(lambda: product(cells, cells)))


def _of_bytes(left: Int8s | Floats, right: Int8s | Floats) -> Numbers:
    """Inner products of int8 rows as int32, shape (left rows, right rows)."""
    import torch
    from torch.utils.dlpack import from_dlpack

    if left.shape[1] == 1:  # PyTorch 2.13 returns uninitialised memory for one column
        return float_product(left, right)
    # `from_numpy` warns of arrays that cannot be written, such as those read from the store; nothing writes to them.
    products: Numbers = torch._int_mm(from_dlpack(left), from_dlpack(right).T).numpy()
    return products


def _seconds(work: Callable[[], object]) -> float:
    """Shortest of `TRIALS` times, in seconds."""
    took = []
    for _ in range(TRIALS):
        began = time.perf_counter()
        work()
        took.append(time.perf_counter() - began)
    return min(took)
