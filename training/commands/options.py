"""Options that the training commands have in common, and how a run begins."""

import argparse
import itertools
import json
import platform
import signal
import time
from pathlib import Path
from typing import Any

import cv2
import torch
import torch.nn.functional as F  # noqa: N812

from training.data.sources import CLIP_FILE
from training.loop import CHECKPOINT, Plan, Run
from worker.configure import keep_freed_memory


def add_run_options(parser: argparse.ArgumentParser, *, trunk: bool = True) -> None:
    """Add the options of any run; `trunk`: whether it needs the pretrained trunk."""
    parser.add_argument("--data", type=Path, required=True, help="has segmentation/, pairs/, unlabelled/, text/")
    if trunk:
        parser.add_argument("--trunk", type=Path, required=True, help="cityscapes_trunk_fp16.npz: the pretrained trunk")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument("--minutes", type=float, default=0.0, help="length of the run; pauses do not count")
    parser.add_argument("--steps", type=int, default=0, help="length of the run in steps")
    parser.add_argument("--resume", action="store_true", help="go on from the folder's checkpoint")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--half", action="store_true", help="bfloat16, where the hardware has it: several times faster")
    parser.add_argument("--threads", type=int, default=1, help="threads of the training process")
    parser.add_argument("--workers", type=int, default=1, help="processes that draw batches; 0: the training process")
    parser.add_argument("--trunk-rate", type=float, default=Plan.trunk_rate, help="learning rate of pretrained layers")
    parser.add_argument("--head-rate", type=float, default=Plan.head_rate, help="learning rate of the heads")


def check_run_options(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Refuse a run without a length, bfloat16 on a processor that only emulates it, and what would fail later.

    Files that are not there would be missed after minutes of labelling, and a second run in a folder would write over
    the first one's checkpoint.
    """
    if not (options.minutes or options.steps) or min(options.minutes, options.steps) < 0:
        parser.error("say how long: --minutes or --steps, above 0")
    if options.half and options.device == "cpu" and (ratio := bfloat16_time_ratio()) > 1.5:
        parser.error(f"bfloat16 takes {ratio:.0f} times as long as float32 on this processor: leave --half out")

    for name in ("trunk", "pretrained", "pretrained_detail", "network"):
        path = getattr(options, name, None)
        if path is not None and not path.is_file():
            parser.error(f"--{name.replace('_', '-')} {path}: there is no such file")
    for name in ("data", "tokens"):
        path = getattr(options, name, None)
        if path is not None and not path.is_dir():
            parser.error(f"--{name} {path}: there is no such folder")
    if hasattr(options, "trunk") and not (options.data / CLIP_FILE).is_file():
        parser.error(f"--data {options.data}: there is no {CLIP_FILE} in it")
    there = (options.out / CHECKPOINT).exists()
    if there and not options.resume:
        parser.error(f"--out {options.out} holds a run: go on with it by --resume, or name another folder")
    if options.resume and not there:
        parser.error(f"--resume: there is no {CHECKPOINT} in {options.out}; leave it out to begin")


def bfloat16_time_ratio() -> float:
    """Measure how long a convolution in bfloat16 takes on this processor, as a multiple of one in float32."""
    dtypes = (torch.bfloat16, torch.float32)
    least = dict.fromkeys(dtypes, float("inf"))
    for _, dtype in itertools.product(range(8), dtypes):
        maps, kernel = torch.ones(1, 64, 48, 48, dtype=dtype), torch.ones(64, 64, 3, 3, dtype=dtype)
        began = time.perf_counter()
        F.conv2d(maps, kernel)
        least[dtype] = min(least[dtype], time.perf_counter() - began)
    return least[torch.bfloat16] / least[torch.float32]


def plan_numbers(options: argparse.Namespace) -> dict[str, Any]:
    """Give the fields of a `Plan` that these options set."""
    return {name: getattr(options, name) for name in ("minutes", "steps", "trunk_rate", "head_rate", "half")}


def prepare(options: argparse.Namespace) -> None:
    """Make the run's folder, and set threads, memory and seed of the process."""
    keep_freed_memory()
    cv2.setNumThreads(1)
    torch.set_num_threads(options.threads)
    torch.manual_seed(options.seed)
    options.out.mkdir(parents=True, exist_ok=True)


def begin(run: Run, options: argparse.Namespace) -> None:
    """Resume a run or write its first checkpoint, log its options in ``runs.jsonl``, and let signals stop it."""
    if options.resume:
        run.resume()
    else:
        run.save()
    described = {name: str(value) for name, value in vars(options).items()}
    described |= {"torch": torch.__version__, "machine": platform.machine(), "from step": str(run.step)}
    with (options.out / "runs.jsonl").open("a") as log:
        log.write(json.dumps(described) + "\n")
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: run.stop())
