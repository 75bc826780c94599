"""What one picture costs the built-in network: ``python -m benchmarks.compact_cost --threads 1``.

With ``--onnx FILE`` ONNX Runtime, which has to be installed, runs the exported graph instead of torch.

Beside it runs a 512 x 512 x 512 float32 matrix product, so that machines can be compared by ratios. CPU time is printed
next to wall time, because on a busy machine only the former means anything (and only with one thread).
"""

import argparse
import datetime
import importlib
import platform
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch

from training.export import network_of
from worker.encoders.memory import keep_freed_memory

SIZES = ((288, 480), (480, 640))


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.compact_cost", description="Cost of one picture.")
    parser.add_argument("--network", type=Path, default=Path("worker/encoders/weights/compact.safetensors"))
    parser.add_argument("--onnx", type=Path, help="an exported graph to run in ONNX Runtime")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--runs", type=int, default=30)
    options = parser.parse_args(arguments)
    keep_freed_memory()
    torch.set_num_threads(options.threads)
    forward = _in_onnx_runtime(options.onnx, options.threads) if options.onnx else network_of(options.network)
    square = torch.randn(512, 512)
    today = datetime.datetime.now(tz=datetime.UTC).date()
    print(f"torch {torch.__version__}, {platform.machine()}, {options.threads} thread(s), {today}")
    with torch.inference_mode():
        for height, width in SIZES:
            picture = torch.rand(1, 3, height, width).contiguous(memory_format=torch.channels_last)
            product = _milliseconds(lambda: square @ square, 4 * options.runs)
            passes = _milliseconds(lambda picture=picture: forward(picture), options.runs)  # type: ignore[misc]
            ratios = [f"{run / unit:.1f}" for run, unit in zip(passes[:2], product[:2], strict=True)]
            print(f"{width}x{height}: wall median {passes[0]:.1f} ms (quartiles {passes[2]:.1f}, {passes[3]:.1f})")
            print(f"  CPU median {passes[1]:.1f} ms; product {product[0]:.2f} wall, {product[1]:.2f} CPU")
            print(f"  ratio to the product: {ratios[0]} wall, {ratios[1]} CPU")


def _in_onnx_runtime(graph: Path, threads: int) -> Callable[[torch.Tensor], object]:
    runtime = importlib.import_module("onnxruntime")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = threads
    session = runtime.InferenceSession(str(graph), options, providers=["CPUExecutionProvider"])
    return lambda picture: session.run(None, {"pictures": picture.numpy()})


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
