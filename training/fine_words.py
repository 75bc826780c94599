"""Train the fine words: ``python -m training.fine_words --weights FILE --data DATA --trunk FILE --out runs/NAME``.

They begin as a copy of an exported network's deep layers and words head, whose shallow layers they share and do not
change: places are recognised as before. Labels are all that they are trained on, on single views, and their embeddings
lie in that network's space: 97 dimensions, the same text vectors.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F  # noqa: N812
from torch import Tensor, nn

from training import data
from training.command import add_run_options, begin, check_run_options, prepare
from training.depthwise import quicken
from training.evaluate_words import fine_words_of
from training.export import basis_of, named, network_of
from training.lexicon import ClipWords, Lexicon
from training.loop import Plan, Run
from training.start import trunk_state
from training.teacher import Teacher, write_labels
from training.word_loss import WordLoss, word_loss_of
from worker.encoders.compact_fine import FineWords
from worker.encoders.compact_network import CompactNetwork


@dataclass(frozen=True)
class FinePlan(Plan):
    """The numbers of a run that trains the fine words.

    Attributes
    ----------
    shared
        SHA-256 of the exported weights whose shallow layers are read.
    rarity
        A pixel counts as its meaning's share of all labelled pixels, to this power.
    overlap
        Weight of the soft IoU beside the word loss.
    points
        How many pixels of each view are drawn to be judged.
    """

    shared: str = ""
    rarity: float = -0.25
    overlap: float = 2.0
    points: int = 3072


class LabelledPixels(nn.Module):
    """The losses of fine words on the single labelled views of `training.data.Batches`.

    Parameters
    ----------
    shared
        Frozen; its shallow layers are read.
    """

    def __init__(self, shared: CompactNetwork, fine: FineWords, word_loss: WordLoss, plan: FinePlan) -> None:
        super().__init__()
        self.shared, self.fine, self.word_loss, self.plan = shared, fine, word_loss, plan

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """Give the weighted sum of both losses, and each of them."""
        pictures = batch["clear_pictures"].float().div(255).contiguous(memory_format=torch.channels_last)
        with torch.autocast(pictures.device.type, torch.bfloat16, enabled=self.plan.half):
            with torch.no_grad():
                levels = self.shared.levels(pictures)
            joined = self.fine.joined(*levels)
        meanings, sets = batch["clear_meanings"], batch["clear_sets"]
        words, points = self.fine.words, self.plan.points
        cells = joined.float().permute(0, 2, 3, 1)
        embeddings = F.normalize(F.linear(cells, words.weight.flatten(1), words.bias), dim=3)
        entropy, overlap = self.word_loss.with_overlap(*drawn_points(embeddings, meanings, sets, points))
        return entropy + self.plan.overlap * overlap, {"word": entropy, "overlap": overlap}


def drawn_points(embeddings: Tensor, meanings: Tensor, sets: Tensor, points: int) -> tuple[Tensor, Tensor, Tensor]:
    """Draw labelled pixels, and interpolate what is said of them as a segmentation does.

    Parameters
    ----------
    embeddings : float of shape (n, h, w, channels)
        Unit length.
    meanings : int of shape (n, k h, k w)
        -1 where nothing is known.
    sets : int64 of shape (n,)
        -1 for pictures without labels.
    points
        How many pixels are drawn of each picture; those without a label are left out.

    Returns
    -------
    tensors of shapes (m, channels), (m,), (m,)
        Embeddings (bilinear), meanings and sets of m <= n x points pixels.
    """
    count, height, width = meanings.shape
    picture = torch.arange(count, device=meanings.device)[:, None].expand(count, points)
    row = torch.randint(height, (count, points), device=meanings.device)
    column = torch.randint(width, (count, points), device=meanings.device)
    target = meanings[picture, row, column].long()
    taught = (target >= 0) & (sets >= 0)[:, None]
    picture, row, column, target = (each[taught] for each in (picture, row, column, target))
    (above, below, down), (left, right, across) = (
        _neighbours(pixel, size, cells)
        for pixel, size, cells in zip((row, column), (height, width), embeddings.shape[1:3], strict=True)
    )
    cells = torch.stack(
        [(picture * embeddings.shape[1] + y) * embeddings.shape[2] + x for y in (above, below) for x in (left, right)],
        dim=1,
    )
    shares = torch.stack([y * x for y in (1 - down, down) for x in (1 - across, across)], dim=1)
    drawn = F.embedding_bag(cells, embeddings.flatten(0, 2), mode="sum", per_sample_weights=shares)
    return drawn, target, sets[picture]


def _neighbours(pixel: Tensor, size: int, cells: int) -> tuple[Tensor, Tensor, Tensor]:
    """Name the two cells whose centres a pixel's centre lies between, along one side, and the second one's share."""
    at = ((pixel + 0.5) * (cells / size) - 0.5).clamp(0, cells - 1)
    first = at.floor().long().clamp(max=cells - 2)
    return first, first + 1, at - first


def started_from(shared: CompactNetwork, earlier: Path | None = None) -> FineWords:
    """Take earlier fine words, or copy a network's deep layers and words head; what sharpens these adds nothing yet."""
    if earlier is not None:
        return fine_words_of(earlier).requires_grad_(True).train()
    fine = FineWords(shared.words.out_channels)
    missing, _ = fine.load_state_dict(shared.state_dict(), strict=False)
    strangers = [name for name in missing if not name.startswith("sharpen.")]
    if strangers:
        raise ValueError(f"the network to start from lacks {', '.join(strangers[:4])}")
    return fine


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, or go on training, and leave a checkpoint and a log in the run's folder."""
    options = _options(arguments)
    prepare(options)
    teacher_labels = options.out / "teacher"
    segmentation = options.data / "segmentation"
    outdoor = [path for name in data.OUTDOOR for path in data.training_pictures(segmentation, name)]
    write_labels(Teacher(trunk_state(options.trunk)), outdoor, teacher_labels)
    splits = ("train", "val") if options.validation_too else ("train",)
    found = data.sources(options.data, teacher_labels, splits)
    lexicon = Lexicon(ClipWords(options.data / data.CLIP_FILE), data.classes(options.data))

    shared = network_of(options.weights)
    fine = started_from(shared, options.earlier)
    if options.device == "cpu":
        quicken(fine)
    vectors = torch.from_numpy(lexicon.vectors) @ basis_of(options.weights)
    word_loss = word_loss_of(found, lexicon, vectors, rarity=options.rarity)
    plan = FinePlan(
        minutes=options.minutes,
        steps=options.steps,
        trunk_rate=options.trunk_rate,
        head_rate=options.head_rate,
        shared=named(options.weights)["sha256"],
        overlap=options.overlap,
        rarity=options.rarity,
        points=options.points,
        half=options.half,
    )
    run = Run(fine, LabelledPixels(shared, fine, word_loss, plan), plan, options.out, device=options.device)
    begin(run, options)
    mix = data.Mix(
        strong=0,
        mild=0,
        clear=options.views,
        clear_strong=options.strong_light,
        clear_shares=data.FINE_SHARES,
        clear_size=(options.height, options.width),
        clear_stride=1,
    )
    run.train(data.stream(data.Batches(found, lexicon, mix, options.seed), run.step, options.loaders))


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m training.fine_words", description="Train the fine words.")
    add_run_options(parser)
    parser.add_argument("--weights", type=Path, required=True, help="exported network to start from")
    parser.add_argument("--earlier", type=Path, help="fine words to start from: checkpoint.pt or exported")
    parser.add_argument("--views", type=int, default=8, help="labelled views a step")
    parser.add_argument("--strong-light", type=float, default=0.2, help="share of views in strongly changed light")
    parser.add_argument("--validation-too", action="store_true", help="learn from the validation pictures too")
    parser.add_argument(
        "--rarity", type=float, default=FinePlan.rarity, help="power of a meaning's share that weighs its pixels"
    )
    parser.add_argument("--points", type=int, default=FinePlan.points, help="pixels judged of a view")
    parser.add_argument("--height", type=int, default=288)
    parser.add_argument("--width", type=int, default=384)
    parser.add_argument("--overlap", type=float, default=FinePlan.overlap, help="weight of the soft IoU")
    options = parser.parse_args(arguments)
    check_run_options(parser, options)
    return options


if __name__ == "__main__":
    main()
