"""Train a segmentation network: ``python -m training.commands.train_segmentation --network FILE --data DATA ...``.

It learns on labelled views, from label maps and from the soft labels of the pretrained trunk. Its embeddings lie in the
97 dimensions of an exported network, so the same text vectors belong to both. By default it shares that network's
shallow layers, which stay as they are, and begins with a copy of its deep layers and semantic head: places are
recognised as before. With ``--independent`` it shares no layer and begins with the trunk. ``--pretrained`` begins with
a segmentation network of either kind that was trained before.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import torch
from safetensors.torch import load_file
from torch import nn

from training.commands.options import add_run_options, begin, check_run_options, plan_numbers, prepare
from training.data.batches import Batches, stream
from training.data.lexicon import CITYSCAPES_LABELS, ClipVectors, Lexicon
from training.data.mix import SEGMENTATION_SHARES, Mix
from training.data.pseudo_labels import write_soft_labels
from training.data.sources import CLIP_FILE, OUTDOOR, find_classes, find_sources
from training.data.viewpoint import ZOOM
from training.loop import Run
from training.losses.distillation import distillation_loss_of
from training.losses.label_loss import label_loss_of
from training.losses.segmentation import SegmentationLosses, SegmentationPlan
from training.models.checkpoints import (
    load_basis,
    load_independent_network,
    load_network,
    load_segmentation_network,
    shared_digest,
)
from training.models.depthwise import use_fast_depthwise
from training.models.initialization import initial_independent_network, initial_segmentation_network, read_trunk
from training.models.teacher import Teacher


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, or resume, and leave a checkpoint and a log in the run's folder."""
    options = _options(arguments)
    prepare(options)
    soft_labels = options.out / "soft_labels"
    splits = ("train", "val") if options.include_validation else ("train",)
    sources = find_sources(options.data, None, splits)
    outdoor = [scene[0].image for name in OUTDOOR if name in sources for scene in sources[name].scenes]
    trunk = read_trunk(options.trunk)
    write_soft_labels(Teacher(trunk).soft_labels, outdoor, soft_labels)
    lexicon = Lexicon(ClipVectors(options.data / CLIP_FILE), find_classes(options.data))

    vectors = torch.from_numpy(lexicon.vectors) @ load_basis(options.network)
    trained: nn.Module
    if options.independent:
        of_trunk = [lexicon.labels.index(label) for label in CITYSCAPES_LABELS]
        trained = independent = initial_independent_network(trunk, vectors[of_trunk])
        if options.pretrained:
            independent.load_state_dict(load_independent_network(options.pretrained).state_dict())
        shallow, segmentation = independent.shallow, independent.fine
    else:
        shallow = shared = load_network(options.network)
        if options.pretrained:
            trained = segmentation = load_segmentation_network(options.pretrained).requires_grad_(True).train()
        else:
            trained = segmentation = initial_segmentation_network(shared)
    if options.device == "cpu":
        use_fast_depthwise(trained)
    label_loss = label_loss_of(sources, lexicon, vectors, weight_power=options.class_weight_power)
    plan = SegmentationPlan(
        **plan_numbers(options),
        shared=shared_digest(load_file(options.network)),
        class_weight_power=options.class_weight_power,
        soft_iou_weight=options.soft_iou_weight,
        distillation_weight=options.distillation_weight,
        pixels=options.pixels,
    )
    objective = SegmentationLosses(shallow, segmentation, label_loss, distillation_loss_of(lexicon, vectors), plan)
    run = Run(trained, objective, plan, options.out, device=options.device)
    begin(run, options)
    mix = Mix(
        strong=0,
        mild=0,
        labelled=options.labelled_views,
        labelled_strong=options.strong_share,
        labelled_pasted=options.pasted_share,
        labelled_shares=options.set_shares,
        labelled_size=(options.height, options.width),
        labelled_zoom=tuple(options.zoom),
        labelled_stride=1,
    )
    run.train(stream(Batches(sources, lexicon, mix, options.seed, soft_labels), run.step, options.workers))


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.train_segmentation", description="Train a segmentation network."
    )
    add_run_options(parser)
    parser.add_argument("--network", type=Path, required=True, help="exported network in whose space it embeds")
    parser.add_argument("--independent", action="store_true", help="share no layers with it; begin with the trunk")
    parser.add_argument("--pretrained", type=Path, help="segmentation network to start from: checkpoint or exported")
    parser.add_argument("--labelled-views", type=int, default=8, help="labelled views a step")
    parser.add_argument("--strong-share", type=float, default=0.2, help="share of views with strong augmentation")
    parser.add_argument("--pasted-share", type=float, default=0.0, help="share of views with pasted foreground objects")
    parser.add_argument("--include-validation", action="store_true", help="learn from the validation images too")
    parser.add_argument(
        "--class-weight-power",
        type=float,
        default=SegmentationPlan.class_weight_power,
        help="a pixel's weight is its class's share of all pixels to this power",
    )
    parser.add_argument("--pixels", type=int, default=SegmentationPlan.pixels, help="pixels drawn of each view")
    parser.add_argument(
        "--set-shares",
        type=float,
        nargs=len(SEGMENTATION_SHARES),
        default=list(SEGMENTATION_SHARES.values()),
        metavar=tuple(SEGMENTATION_SHARES),
        help="how often each labelled set is drawn, relative to the others",
    )
    parser.add_argument("--height", type=int, default=288, help="of a view, in pixels")
    parser.add_argument("--width", type=int, default=384)
    parser.add_argument("--zoom", type=float, nargs=2, default=ZOOM, help="least and greatest enlargement of a view")
    parser.add_argument("--distillation-weight", type=float, default=SegmentationPlan.distillation_weight)
    parser.add_argument("--soft-iou-weight", type=float, default=SegmentationPlan.soft_iou_weight)
    options = parser.parse_args(arguments)
    if not 0 < options.zoom[0] <= options.zoom[1]:
        parser.error(f"--zoom wants the least, above 0, and the greatest: not {options.zoom[0]:g} {options.zoom[1]:g}")
    if min(options.set_shares) < 0 or not any(options.set_shares):
        parser.error(f"--set-shares wants numbers of at least 0, one of them above: not {options.set_shares}")
    check_run_options(parser, options)
    options.set_shares = dict(zip(SEGMENTATION_SHARES, options.set_shares, strict=True))
    return options


if __name__ == "__main__":
    main()
