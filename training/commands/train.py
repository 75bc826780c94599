"""Train the encoder: ``python -m training --data DATA --pretrained FILE --trunk FILE --out runs/NAME --minutes 90``."""

import argparse
from collections.abc import Sequence
from pathlib import Path

import torch

from training.commands.options import add_run_options, begin, check_run_options, plan_numbers, prepare
from training.data.batches import Batches, stream
from training.data.lexicon import ClipVectors, Lexicon
from training.data.mix import Mix
from training.data.pseudo_labels import write_label_maps
from training.data.sources import CLIP_FILE, LABELLED, OUTDOOR, PHOTOS, find_classes, find_sources, training_images
from training.loop import Run
from training.losses.channels import ChannelLosses, ChannelPlan
from training.losses.label_loss import label_loss_of
from training.models.depthwise import use_fast_depthwise
from training.models.detail_head import HalfWhitenedFeatures, PretrainedDetail, fit_detail_head, half_whiten_detail_head
from training.models.initialization import initial_network, read_trunk
from training.models.teacher import Teacher, TeacherFeatures


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, or resume, and leave a checkpoint and a log in the run's folder."""
    options = _options(arguments)
    prepare(options)

    trunk = read_trunk(options.trunk)
    images = [path for name in (*LABELLED, PHOTOS) for path in training_images(options.data / "segmentation", name)]
    outdoor = [path for name in OUTDOOR for path in training_images(options.data / "segmentation", name)]
    pseudo_labels = options.out / "teacher"
    if not options.resume:
        write_label_maps(Teacher(trunk).label_map, outdoor, pseudo_labels)
    sources = find_sources(options.data, pseudo_labels)
    lexicon = Lexicon(ClipVectors(options.data / CLIP_FILE), find_classes(options.data))

    network, missing = initial_network(options.pretrained)
    sample = images[::20]
    if options.pretrained_detail:
        fit_detail_head(network, PretrainedDetail(options.pretrained_detail), sample)
    elif "detail.weight" in missing:
        half_whiten_detail_head(network, sample)
    if options.device == "cpu":
        use_fast_depthwise(network)
    plan = ChannelPlan(
        **plan_numbers(options),
        strong_label_weight=options.strong_label_weight,
        semantic_two_view_weight=options.semantic_two_view_weight,
    )
    label_loss = label_loss_of(sources, lexicon, torch.from_numpy(lexicon.vectors))
    teacher_features = HalfWhitenedFeatures(TeacherFeatures(trunk), sample)
    objective = ChannelLosses(network, label_loss, teacher_features, plan)
    run = Run(network, objective, plan, options.out, device=options.device)
    begin(run, options)
    mix = Mix(
        strong=options.strong_pairs,
        mild=options.mild_pairs,
        labelled=options.labelled_views,
        size=(options.height, options.width),
    )
    run.train(stream(Batches(sources, lexicon, mix, options.seed), run.step, options.workers))


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m training", description="Train the encoder.")
    add_run_options(parser)
    parser.add_argument("--pretrained", type=Path, required=True, help="network to start from: trunk or checkpoint")
    parser.add_argument("--pretrained-detail", type=Path, help="detail network that the detail head is fitted to first")
    parser.add_argument("--strong-pairs", type=int, default=4, help="pairs a step with strong photometric augmentation")
    parser.add_argument("--mild-pairs", type=int, default=4, help="pairs a step with mild photometric augmentation")
    parser.add_argument("--labelled-views", type=int, default=4, help="single labelled views a step")
    parser.add_argument("--height", type=int, default=192, help="of the views of a pair, in pixels")
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument(
        "--strong-label-weight",
        type=float,
        default=ChannelPlan.strong_label_weight,
        help="weight of the label loss under strong augmentation",
    )
    parser.add_argument(
        "--semantic-two-view-weight",
        type=float,
        default=ChannelPlan.semantic_two_view_weight,
        help="weight of the two-view loss of the semantic channel",
    )
    options = parser.parse_args(arguments)
    if min(options.strong_pairs, options.mild_pairs, options.labelled_views) < 1:
        parser.error("--strong-pairs, --mild-pairs and --labelled-views are at least 1: each has a loss of its own")
    check_run_options(parser, options)
    return options


if __name__ == "__main__":
    main()
