"""Command line: ``python -m training --data DATA --pretrained FILE --trunk FILE --out runs/NAME --minutes 90``."""

import argparse
from collections.abc import Sequence
from pathlib import Path

import torch

from training.commands.options import add_run_options, begin, check_run_options, prepare, run_numbers
from training.data import batches as data
from training.data.lexicon import ClipWords, Lexicon
from training.data.mix import Mix
from training.loop import Run
from training.losses.label_loss import word_loss_of
from training.losses.two_channels import TwoChannelPlan, TwoChannels
from training.models.depthwise import quicken
from training.models.detail_head import EarlierDetail, SpreadFeatures, fit_detail_head, spread_detail_head
from training.models.initialization import started, trunk_state
from training.models.teacher import Shallow, Teacher, write_labels


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, or go on training, and leave a checkpoint and a log in the run's folder."""
    options = _options(arguments)
    prepare(options)

    trunk = trunk_state(options.trunk)
    images = [path for name in data.LABELLED for path in data.training_images(options.data / "segmentation", name)]
    outdoor = [path for name in data.OUTDOOR for path in data.training_images(options.data / "segmentation", name)]
    teacher_labels = options.out / "teacher"
    if not options.resume:
        write_labels(Teacher(trunk), outdoor, teacher_labels)
    found = data.sources(options.data, teacher_labels)
    lexicon = Lexicon(ClipWords(options.data / data.CLIP_FILE), data.classes(options.data))

    network, missing = started(options.pretrained)
    sample = images[::20]
    if options.detail:
        fit_detail_head(network, EarlierDetail(options.detail), sample)
    elif "detail.weight" in missing:
        spread_detail_head(network, sample)
    if options.device == "cpu":
        quicken(network)
    plan = TwoChannelPlan(
        **run_numbers(options),
        strong_word=options.strong_word,
        words_two_view=options.words_two_view,
    )
    word_loss = word_loss_of(found, lexicon, torch.from_numpy(lexicon.vectors))
    objective = TwoChannels(network, word_loss, SpreadFeatures(Shallow(trunk), sample), plan)
    run = Run(network, objective, plan, options.out, device=options.device)
    begin(run, options)
    mix = Mix(strong=options.strong, mild=options.mild, clear=options.clear, size=(options.height, options.width))
    batches = data.Batches(found, lexicon, mix, options.seed)
    run.train(data.stream(batches, run.step, options.loaders))


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m training", description="Train the built-in encoder.")
    add_run_options(parser)
    parser.add_argument("--pretrained", type=Path, required=True, help="start: the trunk or an earlier network")
    parser.add_argument("--detail", type=Path, help="an earlier detail network to start the detail head from")
    parser.add_argument("--strong", type=int, default=4, help="pairs a step under strongly changed light")
    parser.add_argument("--mild", type=int, default=4, help="pairs a step under mildly changed light")
    parser.add_argument("--clear", type=int, default=4, help="single labelled views a step, for the words alone")
    parser.add_argument("--height", type=int, default=192)
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument(
        "--strong-word",
        type=float,
        default=TwoChannelPlan.strong_word,
        help="weight of the word loss under changed light",
    )
    parser.add_argument(
        "--words-two-view", type=float, default=TwoChannelPlan.words_two_view, help="weight of the words' two-view loss"
    )
    options = parser.parse_args(arguments)
    if min(options.strong, options.mild, options.clear) < 1:
        parser.error("--strong, --mild and --clear are at least 1: each teaches something that the others do not")
    check_run_options(parser, options)
    return options


if __name__ == "__main__":
    main()
