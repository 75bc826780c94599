"""Train the distilled head: ``python -m training.commands.train_distilled --network FILE --tokens FOLDER --data DATA``.

It learns from a teacher's tokens that `training.commands.cache_tokens` computed. The network below it stays as it is,
so its other channels, and everything trained with them, do too.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from training.commands.options import add_run_options, begin, check_run_options, plan_numbers, prepare
from training.data.batches import stream
from training.data.crop_batches import CropBatches, find_scenes
from training.data.teacher_space import TeacherSpace
from training.loop import Run
from training.losses.distilled import DistilledLosses, DistilledPlan
from training.models.checkpoints import load_network
from training.models.depthwise import use_fast_depthwise
from training.models.distilled_head import DISTILLED_CHANNELS, DistilledHead


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, or resume, and leave a checkpoint and a log in the run's folder."""
    options = _options(arguments)
    prepare(options)
    space_file = options.out / "space.npz"
    if not space_file.exists():
        files = sorted(path for path in options.tokens.glob("*.npy") if ".partial" not in path.suffixes)
        TeacherSpace.fit(files, DISTILLED_CHANNELS, options.seed).save(space_file)
    space = TeacherSpace.load(space_file)
    network = load_network(options.network)
    head = DistilledHead()
    if options.device == "cpu":
        use_fast_depthwise(head)
    plan = DistilledPlan(**plan_numbers(options), two_view_weight=options.two_view_weight)
    run = Run(head, DistilledLosses(network, head, plan), plan, options.out, device=options.device)
    begin(run, options)
    scenes = find_scenes(options.data)
    batches = CropBatches(scenes, options.data, options.tokens, space, options.pairs, options.seed)
    run.train(stream(batches, run.step, options.workers))


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.train_distilled", description="Train the distilled head."
    )
    add_run_options(parser, trunk=False)
    parser.add_argument("--network", type=Path, required=True, help="the exported network below: .safetensors")
    parser.add_argument("--tokens", type=Path, required=True, help="folder that cache_tokens filled")
    parser.add_argument("--pairs", type=int, default=8, help="pairs of views a step")
    parser.add_argument("--two-view-weight", type=float, default=DistilledPlan.two_view_weight)
    options = parser.parse_args(arguments)
    check_run_options(parser, options)
    return options


if __name__ == "__main__":
    main()
