"""What one image costs the built-in network: ``python -m lab.benchmarks.compact_cost --threads 1 [--engine torch]``.

Both engines start from an image at the network's size, uint8, and end with fields in numpy arrays. On a GPU
(``--engine torch --device cuda --batch 8``) all times are of a batch.

Beside them runs a 512 x 512 x 512 float32 matrix product, so that machines can be compared by ratios. CPU time is
printed next to wall time, because on a busy machine only the former means anything (and only with one thread).
"""

import argparse
import datetime
import platform
import time
from collections.abc import Callable, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch

from worker.configure import keep_freed_memory
from worker.encoders.compact.encoder import WEIGHTS
from worker.encoders.compact.engine import Engine
from worker.encoders.compact.ensemble import ENSEMBLE
from worker.encoders.compact.onnx import OnnxEngine
from worker.encoders.compact.torch import TorchEngine

SIZES = ((288, 480), (480, 640))


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m lab.benchmarks.compact_cost", description="Cost of one image.")
    parser.add_argument("--weights", type=Path, default=WEIGHTS)
    parser.add_argument("--engine", choices=("onnxruntime", "torch"), default="onnxruntime")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--device", default="cpu", help="of torch")
    parser.add_argument("--batch", type=int, default=1, help="images that go through the network together")
    options = parser.parse_args(arguments)
    if options.engine == "onnxruntime" and options.device != "cpu":
        parser.error(f"--device {options.device} needs --engine torch")
    torch.set_num_threads(options.threads)
    engine = _engine(options.engine, options.weights, options.threads, options.device)
    square = torch.randn(512, 512)
    today = datetime.datetime.now(tz=datetime.UTC).date()
    device = platform.machine() if options.device == "cpu" else torch.cuda.get_device_name(options.device)
    print(f"{options.engine} {version(options.engine)}, {device}, {options.threads} thread(s), {today}")
    for height, width in SIZES:
        image = np.random.default_rng(0).integers(0, 256, (options.batch, height, width, 3), np.uint8)
        runs: dict[str, Callable[[], object]] = {"semantic and detail": partial(engine.fields, image)}
        runs |= {
            f"segmentation, member {member}": partial(engine.segment, image, at) for at, member in enumerate(ENSEMBLE)
        }
        for outputs, run in runs.items():
            product = _milliseconds(lambda: square @ square, 4 * options.runs)
            passes = _milliseconds(run, options.runs)
            ratios = [f"{taken / unit:.1f}" for taken, unit in zip(passes[:2], product[:2], strict=True)]
            print(f"{width}x{height}, {outputs}:")
            print(f"  wall median {passes[0]:.1f} ms (quartiles {passes[2]:.1f}, {passes[3]:.1f})")
            print(f"  CPU median {passes[1]:.1f} ms; product {product[0]:.2f} wall, {product[1]:.2f} CPU")
            print(f"  ratio to the product: {ratios[0]} wall, {ratios[1]} CPU")


def _engine(name: str, weights: Path, threads: int, device: str) -> Engine:
    fine = [weights.with_name(f"{weights.stem}-{member}.safetensors") for member in ENSEMBLE]
    if name == "torch":
        keep_freed_memory()
        return TorchEngine(weights.read_bytes(), [path.read_bytes() for path in fine], device)
    return OnnxEngine(weights.with_suffix(".onnx"), [path.with_suffix(".onnx") for path in fine], threads=threads)


def _milliseconds(action: Callable[[], object], runs: int) -> tuple[float, float, float, float]:
    """Time an action: median wall, median CPU, lower and upper quartile of wall, in ms."""
    for _ in range(3):
        action()
    wall, cpu = [], []
    for _ in range(runs):
        began, used = time.perf_counter(), time.process_time()
        action()
        wall.append(time.perf_counter() - began)
        cpu.append(time.process_time() - used)
    low, middle, high = (1e3 * float(q) for q in np.quantile(wall, (0.25, 0.5, 0.75)))
    return middle, 1e3 * float(np.median(cpu)), low, high


if __name__ == "__main__":
    main()
