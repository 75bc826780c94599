"""Train the segmentation network: ``python -m training.commands.train_segmentation --weights FILE --data DATA --trunk FILE --out runs/NAME``.

They begin as a copy of an exported network's deep layers and words head, whose shallow layers they share and do not
change: places are recognised as before. They learn on single views, from labels and from what the untouched trunk says,
and their embeddings lie in that network's space: 97 dimensions, the same text vectors. With ``--second`` a network of
its own learns the same, to be a second opinion: from the trunk on, or from where an ``--earlier`` one ended.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F  # noqa: N812
from safetensors.torch import load_file
from torch import Tensor, nn

from training.commands.evaluate_segmentation import second_of, segmentation_network_of
from training.commands.export import basis_of, network_of, shared_digest
from training.commands.options import add_run_options, begin, check_run_options, prepare, run_numbers
from training.data import batches as data
from training.data.lexicon import STREET_WORDS, ClipWords, Lexicon
from training.data.mix import SEGMENTATION_SHARES, Mix
from training.data.viewpoint import ZOOM
from training.loop import Plan, Run
from training.losses import pixel_sampling as points
from training.losses.distillation import OpinionLoss, opinion_loss_of
from training.losses.label_loss import WordLoss, word_loss_of
from training.models.depthwise import quicken
from training.models.initialization import second_started, trunk_state
from training.models.teacher import Teacher, write_opinions
from worker.encoders.compact.network import CompactNetwork, ShallowLayers
from worker.encoders.compact.segmentation import SegmentationNetwork


@dataclass(frozen=True)
class SegmentationPlan(Plan):
    """The numbers of a run that trains the segmentation network.

    Attributes
    ----------
    shared
        `training.commands.export.shared_digest` of the exported weights whose shallow layers are read.
    rarity
        A pixel counts as its meaning's share of all labelled pixels, to this power.
    overlap
        Weight of the soft IoU beside the word loss.
    opinion
        Weight of the difference from what the untouched trunk says.
    points
        How many pixels of each view are drawn to be judged.
    """

    shared: str = ""
    rarity: float = -0.25
    overlap: float = 2.0
    opinion: float = 0.5
    points: int = 3072


class LabelledPixels(nn.Module):
    """The losses of segmentation network on the single labelled views of `training.data.batches.Batches`.

    Parameters
    ----------
    shallow
        What gives the levels that `fine` reads; not trained if none of its parameters wants a gradient.
    """

    def __init__(
        self,
        shallow: ShallowLayers,
        fine: SegmentationNetwork,
        word_loss: WordLoss,
        opinion_loss: OpinionLoss,
        plan: SegmentationPlan,
    ) -> None:
        super().__init__()
        self.shallow, self.fine, self.plan = shallow, fine, plan
        self.word_loss, self.opinion_loss = word_loss, opinion_loss

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """Give the weighted sum of the losses, and each of them."""
        images = batch["clear_pictures"].float().div(255).contiguous(memory_format=torch.channels_last)
        with torch.autocast(images.device.type, torch.bfloat16, enabled=self.plan.half):
            joined = self.fine.joined(*self.shallow.levels(images))
        words = self.fine.words
        cells = F.linear(joined.float().permute(0, 2, 3, 1), words.weight.flatten(1), words.bias)

        meanings, sets = batch["clear_meanings"], batch["clear_sets"]
        size = (meanings.shape[1], meanings.shape[2])
        drawn = points.draw(len(images), size, self.plan.points, images.device)
        embeddings = points.interpolated(F.normalize(cells, dim=3), drawn, size)
        target, owner = meanings[drawn.view, drawn.row, drawn.column].long(), sets[drawn.view]
        taught = (target >= 0) & (owner >= 0)
        entropy, overlap = self.word_loss.with_overlap(embeddings[taught], target[taught], owner[taught])
        opinions, inside = points.read_in_source(batch["clear_opinions"].float(), batch["clear_views"], drawn, size)
        opinion = self.opinion_loss(embeddings[inside], opinions[inside], target[inside])
        total = entropy + self.plan.overlap * overlap + self.plan.opinion * opinion
        return total, {"word": entropy, "overlap": overlap, "opinion": opinion}


def started_from(shared: CompactNetwork, earlier: Path | None = None) -> SegmentationNetwork:
    """Take earlier segmentation network, or copy a network's deep layers and words head; what sharpens these adds nothing yet."""
    if earlier is not None:
        return segmentation_network_of(earlier).requires_grad_(True).train()
    fine = SegmentationNetwork(shared.words.out_channels)
    missing, _ = fine.load_state_dict(shared.state_dict(), strict=False)
    unknown_places = [name for name in missing if not name.startswith("sharpen.")]
    if unknown_places:
        raise ValueError(f"the network to start from lacks {', '.join(unknown_places[:4])}")
    return fine


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, or go on training, and leave a checkpoint and a log in the run's folder."""
    options = _options(arguments)
    prepare(options)
    opinions = options.out / "opinions"
    splits = ("train", "val") if options.validation_too else ("train",)
    found = data.sources(options.data, None, splits)
    outdoor = [scene[0].image for name in data.OUTDOOR if name in found for scene in found[name].scenes]
    trunk = trunk_state(options.trunk)
    write_opinions(Teacher(trunk), outdoor, opinions)
    lexicon = Lexicon(ClipWords(options.data / data.CLIP_FILE), data.classes(options.data))

    vectors = torch.from_numpy(lexicon.vectors) @ basis_of(options.weights)
    learner: nn.Module
    if options.second:
        spoken = [lexicon.words.index(word) for word in STREET_WORDS]
        learner = second = second_started(trunk, vectors[spoken])
        if options.earlier:
            second.load_state_dict(second_of(options.earlier).state_dict())
        shallow, fine = second.shallow, second.fine
    else:
        shallow = shared = network_of(options.weights)
        learner = fine = started_from(shared, options.earlier)
    if options.device == "cpu":
        quicken(learner)
    word_loss = word_loss_of(found, lexicon, vectors, rarity=options.rarity)
    opinion_loss = opinion_loss_of(lexicon, vectors)
    plan = SegmentationPlan(
        **run_numbers(options),
        shared=shared_digest(load_file(options.weights)),
        overlap=options.overlap,
        rarity=options.rarity,
        opinion=options.opinion,
        points=options.points,
    )
    objective = LabelledPixels(shallow, fine, word_loss, opinion_loss, plan)
    run = Run(learner, objective, plan, options.out, device=options.device)
    begin(run, options)
    mix = Mix(
        strong=0,
        mild=0,
        clear=options.views,
        clear_strong=options.strong_light,
        clear_pasted=options.pasted,
        clear_shares=options.shares,
        clear_size=(options.height, options.width),
        clear_zoom=tuple(options.zoom),
        clear_stride=1,
    )
    run.train(data.stream(data.Batches(found, lexicon, mix, options.seed, opinions), run.step, options.loaders))


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.train_segmentation", description="Train the fine words."
    )
    add_run_options(parser)
    parser.add_argument("--weights", type=Path, required=True, help="exported network to start from")
    parser.add_argument("--earlier", type=Path, help="fine words to start from: checkpoint.pt or exported")
    parser.add_argument("--second", action="store_true", help="train a second network of fine words, from the trunk on")
    parser.add_argument("--views", type=int, default=8, help="labelled views a step")
    parser.add_argument("--strong-light", type=float, default=0.2, help="share of views in strongly changed light")
    parser.add_argument("--pasted", type=float, default=0.0, help="share of views that things are pasted onto")
    parser.add_argument("--validation-too", action="store_true", help="learn from the validation pictures too")
    parser.add_argument(
        "--rarity",
        type=float,
        default=SegmentationPlan.rarity,
        help="power of a meaning's share that weighs its pixels",
    )
    parser.add_argument("--points", type=int, default=SegmentationPlan.points, help="pixels judged of a view")
    parser.add_argument(
        "--shares",
        type=float,
        nargs=len(SEGMENTATION_SHARES),
        default=list(SEGMENTATION_SHARES.values()),
        metavar=tuple(SEGMENTATION_SHARES),
        help="how often each labelled set is drawn",
    )
    parser.add_argument("--height", type=int, default=288)
    parser.add_argument("--width", type=int, default=384)
    parser.add_argument("--zoom", type=float, nargs=2, default=ZOOM, help="least and greatest enlargement of a view")
    parser.add_argument("--opinion", type=float, default=SegmentationPlan.opinion, help="weight of what the trunk says")
    parser.add_argument("--overlap", type=float, default=SegmentationPlan.overlap, help="weight of the soft IoU")
    options = parser.parse_args(arguments)
    check_run_options(parser, options)
    if not 0 < options.zoom[0] <= options.zoom[1]:
        parser.error(f"--zoom wants the least, above 0, and the greatest: not {options.zoom[0]:g} {options.zoom[1]:g}")
    if min(options.shares) < 0 or not any(options.shares):
        parser.error(f"--shares wants numbers of at least 0, one of them above: not {options.shares}")
    options.shares = dict(zip(SEGMENTATION_SHARES, options.shares, strict=True))
    return options


if __name__ == "__main__":
    main()
