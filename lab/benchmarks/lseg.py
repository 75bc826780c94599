"""Speed and memory of the encoder lseg: ``python -m lab.benchmarks.lseg [--weights FILE]``.

With ``--compare IMAGE...``: how far the mode ``single`` and lower precisions depart from the reference instead.

One process per row, so that each row's memory is its own. Without ``--weights`` the network has random ones: its
speed does not depend on them. The machine's speed at multiplying matrices is measured beside it, as the bound; the
arithmetic is counted by `lab.benchmarks.lseg_cost`.
"""

import argparse
import functools
import multiprocessing
import os
import platform
import resource
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import cast

import numpy as np
import torch
from PIL import Image as PilImage

from lab.benchmarks.lseg_cost import multiply_adds
from schemas.image import Image
from worker.description.presets import PAPER_LABELS
from worker.encoders.lseg.checkpoint import load
from worker.encoders.lseg.config import PUBLISHED
from worker.encoders.lseg.encoder import LsegEncoder, Mode
from worker.encoders.lseg.enlarge import Axis, enlarge
from worker.encoders.lseg.linear import linear
from worker.encoders.lseg.network import Network
from worker.encoders.lseg.tokenizer import Tokenizer
from worker.encoders.lseg.windows import Single, Windows

REFERENCE = ("windows", "float32")

DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}


@dataclass(frozen=True)
class Row:
    """What to measure."""

    mode: Mode
    dtype: str
    batch: int
    device: str
    threads: int
    size: tuple[int, int]
    images: int
    repeats: int
    weights: Path | None


@dataclass(frozen=True)
class Measured:
    """What was seen: seconds and CPU seconds per image, bytes, and floating-point operations per second."""

    seconds: list[float]
    cpu_seconds: float
    memory: int
    work: float
    matmul: float
    dense: float


def network(weights: Path | None) -> Network:
    """Weights from a file, or random ones of a size that keeps numbers finite."""
    if weights is not None:
        return load(weights)[0]
    with torch.device("meta"):
        empty = Network(PUBLISHED)
    generator = torch.Generator().manual_seed(0)
    state = {
        name: torch.rand(tensor.shape, generator=generator).mul_(2 / max(1, tensor[0].numel()) ** 0.5)
        for name, tensor in empty.state_dict().items()
    }
    empty.load_state_dict(state, assign=True)
    return empty.eval().requires_grad_(False)


def best(act: Callable[[], object], device: str, repeats: int = 30) -> float:
    """Seconds of the fastest run after one to warm up."""
    return min(timed(act, device) for _ in range(repeats + 1))


def timed(act: Callable[[], object], device: str) -> float:
    """Seconds until the device has done it."""
    start = time.perf_counter()
    act()
    if device != "cpu":
        torch.cuda.synchronize(device)
    return time.perf_counter() - start


def matrix_speeds(row: Row) -> tuple[float, float]:
    """Operations per second: of torch.matmul on a large square, and of the encoder's own routine on a dense layer."""
    dtype = DTYPES[row.dtype]
    side = 1024 if row.device == "cpu" else 8192
    a, b = (torch.randn(side, side, device=row.device).to(dtype) for _ in range(2))
    x, w = torch.randn(901, 1024, device=row.device).to(dtype), torch.randn(4096, 1024, device=row.device).to(dtype)
    with torch.inference_mode():
        square = 2 * side**3 / best(lambda: a @ b, row.device)
        dense = 2 * 901 * 1024 * 4096 / best(lambda: linear(x, w), row.device)
    return square, dense


def operations(mode: Mode, size: tuple[int, int], batch: int) -> float:
    """Floating-point operations for one image, as the encoder does them."""
    covering = Windows(PUBLISHED) if mode == "windows" else Single(PUBLISHED)
    inputs = covering.inputs(np.zeros((*size, 3), np.uint8))
    passes = [((i.pixels.shape[1], i.pixels.shape[2]), i.keep if batch == 1 else None) for i in inputs]
    return 2.0 * sum(sum(multiply_adds(PUBLISHED, sides, keep).values()) for sides, keep in passes)


def measure(row: Row) -> Measured:
    """One row, in a process of its own."""
    torch.set_num_threads(row.threads)
    tokenizer = Tokenizer([], PUBLISHED.context)
    encoder = LsegEncoder(
        network(row.weights),
        tokenizer,
        "",
        mode=row.mode,
        device=row.device,
        dtype=DTYPES[row.dtype],
        batch=row.batch,
    )
    rng = np.random.default_rng(0)
    pixels = [rng.integers(0, 256, (*row.size, 3)).astype(np.uint8) for _ in range(row.images)]
    images = [Image.of(p) for p in pixels]

    def describe() -> None:
        for field in encoder.encode(images):
            del field

    timed(describe, row.device)
    cpu = time.process_time()
    seconds = [timed(describe, row.device) / row.images for _ in range(row.repeats)]
    cpu = (time.process_time() - cpu) / row.repeats / row.images
    if row.device == "cpu":
        # Kilobytes on Linux, bytes on macOS.
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if platform.system() == "Darwin" else 1024)
    else:
        memory = torch.cuda.max_memory_allocated(row.device)
    return Measured(seconds, cpu, memory, operations(row.mode, row.size, row.batch), *matrix_speeds(row))


def line(row: Row, seen: Measured) -> str:
    """A row of the table."""
    fastest, middle = min(seen.seconds), statistics.median(seen.seconds)
    speed = seen.work / fastest
    return (
        f"| {row.mode} | {row.dtype} | {row.batch} | {fastest:.2f} ({middle:.2f}) | {1 / fastest:.3f} "
        f"| {seen.cpu_seconds:.2f} | {seen.work / 1e12:.3f} | {speed / 1e9:.0f} | {speed / seen.matmul:.0%} "
        f"| {speed / seen.dense:.0%} | {seen.memory / 1e9:.2f} |"
    )


def compare(weights: Path, images: list[Path], variants: list[tuple[Mode, str]], device: str) -> None:
    """Print how other modes and precisions differ from windows in float32, cell by cell of the reference's grid."""
    print("| image | mode | precision | labels equal | cosine, mean | cosine, lowest hundredth |\n|" + " --- |" * 6)
    for path in images:
        image = Image.of(np.asarray(PilImage.open(path).convert("RGB")))
        exact = LsegEncoder.open(weights, device=device, dtype=torch.float32)
        vectors = torch.from_numpy(exact.text_vectors(PAPER_LABELS)).to(device)
        wanted = next(exact.raw([image]))
        labels = (wanted @ vectors.T).argmax(-1)
        for mode, dtype in variants:
            other = LsegEncoder.open(weights, mode=mode, device=device, dtype=DTYPES[dtype])
            raw = next(other.raw([image]))
            rows, columns = map(Axis.whole, raw.shape[:2], wanted.shape[:2])
            raw = enlarge(raw[None], rows, columns)[0]
            equal = ((raw @ vectors.T).argmax(-1) == labels).float().mean().item()
            cosine = torch.cosine_similarity(raw, wanted, dim=-1).flatten().sort().values
            low = cosine[len(cosine) // 100].item()
            print(
                f"| {path.stem} | {mode} | {dtype} | {equal:.2%} | {cosine.mean().item():.5f} | {low:.5f} |", flush=True
            )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print versions and the table."""
    parser = argparse.ArgumentParser(
        prog="revisit benchmark lseg", description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument("--weights", type=Path)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--modes", nargs="+", choices=["windows", "single"], default=["windows", "single"])
    parser.add_argument("--dtypes", nargs="+", choices=list(DTYPES))
    parser.add_argument("--batches", nargs="+", type=int)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--size", type=int, nargs=2, default=[376, 1241], metavar=("HEIGHT", "WIDTH"))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--compare", type=Path, nargs="+", metavar="IMAGE")
    options = parser.parse_args(arguments)
    if options.compare:
        torch.set_num_threads(options.threads)
        variants = [(m, d) for m in options.modes for d in options.dtypes or ["float32"] if (m, d) != REFERENCE]
        compare(options.weights, options.compare, variants, options.device)
        return
    on_cpu = options.device == "cpu"
    batches = options.batches or ([1] if on_cpu else [1, 2, 8, 16, 32])
    name = platform.processor() if on_cpu else torch.cuda.get_device_name(options.device)
    print(
        f"{datetime.now(UTC):%Y-%m-%d}, Python {platform.python_version()}, torch {torch.__version__}, {options.device}"
    )
    print(f"{name or platform.machine()}, {options.threads} threads, {options.size[0]} x {options.size[1]} pixels\n")
    print(
        "| mode | precision | batch | s/image, best (median) | images/s | CPU s/image | TFLOP/image | GFLOP/s "
        "| of torch.matmul | of a dense layer | memory, GB |\n|" + " --- |" * 11
    )
    process = functools.partial(multiprocessing.get_context("spawn").Pool, 1)
    for mode in options.modes:
        for dtype in options.dtypes or (["float32"] if on_cpu else list(DTYPES)):
            for batch in batches:
                size = cast(tuple[int, int], tuple(options.size))
                row = Row(
                    mode, dtype, batch, options.device, options.threads, size, batch, options.repeats, options.weights
                )
                with process() as one:
                    print(line(row, one.apply(measure, (row,))), flush=True)


if __name__ == "__main__":
    main()
