"""Command line: ``python -m training --data DATA --pretrained FILE --trunk FILE --out runs/NAME --minutes 90``."""

import argparse
import dataclasses
import json
import platform
import signal
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch

from training import data
from training.depthwise import quicken
from training.detail_start import EarlierDetail, SpreadFeatures, fit_detail_head, spread_detail_head
from training.lexicon import ClipWords, Lexicon
from training.loop import Plan, Run
from training.losses import WordLoss
from training.start import started, trunk_state
from training.teacher import Shallow, Teacher, write_labels
from worker.encoders.memory import keep_freed_memory

WORD_TEMPERATURE = 0.07
RARITY = -0.4
"""A pixel counts as its meaning's share of all labelled pixels, to this power: a pole four times as much as road."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, or go on training, and leave a checkpoint and a log in the run's folder."""
    options = _options(arguments)
    keep_freed_memory()
    cv2.setNumThreads(1)
    torch.set_num_threads(options.threads)
    torch.manual_seed(options.seed)
    options.out.mkdir(parents=True, exist_ok=True)

    trunk = trunk_state(options.trunk)
    pictures = [path for name in data.LABELLED for path in data.training_pictures(options.data / "segmentation", name)]
    outdoor = [path for name in data.OUTDOOR for path in data.training_pictures(options.data / "segmentation", name)]
    teacher_labels = options.out / "teacher"
    if not options.resume:
        write_labels(Teacher(trunk), outdoor, teacher_labels)
    found = data.sources(options.data, teacher_labels)
    lexicon = Lexicon(ClipWords(options.data / data.CLIP_FILE), data.classes(options.data))

    network, missing = started(options.pretrained)
    sample = pictures[::20]
    if options.detail:
        fit_detail_head(network, EarlierDetail(options.detail), sample)
    elif "detail.weight" in missing:
        spread_detail_head(network, sample)
    if options.device == "cpu":
        quicken(network)
    plan = dataclasses.replace(
        Plan(),
        minutes=options.minutes,
        steps=options.steps,
        trunk_rate=options.trunk_rate,
        head_rate=options.head_rate,
        strong_word=options.strong_word,
        words_two_view=options.words_two_view,
    )
    run = Run(
        network,
        _word_loss(found, lexicon),
        SpreadFeatures(Shallow(trunk), sample),
        plan,
        options.out,
        device=options.device,
        half=options.half,
    )
    if options.resume:
        run.resume()
    else:
        run.save()
    described = {name: str(value) for name, value in vars(options).items()}
    described |= {"torch": torch.__version__, "machine": platform.machine(), "from step": str(run.step)}
    with (options.out / "runs.jsonl").open("a") as log:
        log.write(json.dumps(described) + "\n")
    mix = data.Mix(strong=options.strong, mild=options.mild, clear=options.clear, size=(options.height, options.width))
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: run.stop())
    batches = data.Batches(found, lexicon, mix, options.seed)
    run.train(data.stream(batches, run.step, options.loaders))


def _word_loss(found: dict[str, data.Source], lexicon: Lexicon) -> WordLoss:
    shares = data.meaning_shares(found, lexicon)
    weights = (shares + 1e-4) ** RARITY
    return WordLoss(
        torch.from_numpy(lexicon.vectors),
        torch.from_numpy(lexicon.members()),
        torch.from_numpy(lexicon.known()),
        torch.from_numpy((weights / weights.mean()).astype(np.float32)),
        WORD_TEMPERATURE,
    )


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m training", description="Train the built-in encoder.")
    parser.add_argument("--data", type=Path, required=True, help="has segmentation/, pairs/, unlabelled/, text/")
    parser.add_argument("--trunk", type=Path, required=True, help="cityscapes_trunk_fp16.npz: teacher, and start")
    parser.add_argument("--pretrained", type=Path, required=True, help="start: the trunk or an earlier network")
    parser.add_argument("--detail", type=Path, help="an earlier detail network to start the detail head from")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument("--minutes", type=float, default=0.0, help="length of the run; pauses do not count")
    parser.add_argument("--steps", type=int, default=0, help="length of the run in steps")
    parser.add_argument("--resume", action="store_true", help="go on from the folder's checkpoint")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--half", action="store_true", help="bfloat16 where the hardware has it; several times faster")
    parser.add_argument("--threads", type=int, default=1, help="threads of the training process")
    parser.add_argument("--loaders", type=int, default=1, help="processes that draw batches")
    parser.add_argument("--strong", type=int, default=4, help="pairs a step under strongly changed light")
    parser.add_argument("--mild", type=int, default=4, help="pairs a step under mildly changed light")
    parser.add_argument("--clear", type=int, default=4, help="single labelled views a step, for the words alone")
    parser.add_argument("--height", type=int, default=192)
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument("--trunk-rate", type=float, default=Plan.trunk_rate)
    parser.add_argument("--head-rate", type=float, default=Plan.head_rate)
    parser.add_argument(
        "--strong-word", type=float, default=Plan.strong_word, help="weight of the word loss under changed light"
    )
    parser.add_argument(
        "--words-two-view", type=float, default=Plan.words_two_view, help="weight of the words' two-view loss"
    )
    options = parser.parse_args(arguments)
    if min(options.strong, options.mild, options.clear) < 1:
        parser.error("--strong, --mild and --clear are at least 1: each teaches something that the others do not")
    if not options.minutes and not options.steps:
        parser.error("say how long: --minutes or --steps")
    return options


if __name__ == "__main__":
    main()
