"""Mean intersection over union of the words: ``python -m training.commands.evaluate_segmentation --network FILE --data DATA``.

As LSeg is judged: the words of a set's own classes are put to the network, a class scoring as its best word, and each
pixel takes the best class. CamVid has 11 classes, LabelMeFacade 8; of NYUv2's 37 the 13 with most labelled pixels in
its training pictures are taken and pixels of the others are left out.

Judged are the segmentation network (``--fine FILE --second FILES``), which segmentations are drawn from, as the service has them
(`segment_with_ensemble` of the encoder), and without that option the words field that descriptions are made of. Pictures
come at two sizes: as the service sees them, 480 on the longer side (``service``), and at their own, times ``--scale``
(``own``). Scores are enlarged to the labels' size before the best class is taken.
"""

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F  # noqa: N812
from safetensors.torch import load_file
from torch import Tensor

from training.commands.export import basis_of, network_of
from training.data import batches as data
from training.data.images import Image, read_labels, read_rgb
from training.data.lexicon import ClipWords, Floats, class_words
from worker.configure import keep_freed_memory
from worker.encoders.compact.encoder import LONGEST, resized, segment_with_ensemble
from worker.encoders.compact.network import CompactNetwork
from worker.encoders.compact.segmentation import IndependentSegmentationNetwork, SegmentationNetwork

JUDGED = {"camvid": 11, "labelmefacade": 8, "nyuv2": 13}
"""Sets, and how many of their classes are judged: the most common ones."""

Embed = Callable[[Image, float], Floats]
"""A picture, uint8 (height, width, 3), and its longer side as judged, to float32 (rows, columns, channels)."""


@dataclass(frozen=True)
class Task:
    """One set's classes: label values, names, and the words of each, in one row of text vectors after the other."""

    values: list[int]
    names: list[str]
    rows: list[list[int]]
    vectors: npt.NDArray[np.float32]


def task(segmentation: Path, data_set: str, clip: ClipWords) -> Task:
    """Choose a set's classes and look their words up."""
    attributes = class_words(segmentation / data_set / "classes.json")
    counts = np.zeros(256)
    for path in data.training_images(segmentation, data_set)[::4]:
        labels = read_labels(data.labels_of(path))
        counts += np.bincount(labels.ravel(), minlength=256)
    known = {value: [word for word in words if clip.sources(word)] for value, words in attributes.items()}
    common = sorted((value for value in known if known[value]), key=lambda value: -counts[value])
    values = sorted(common[: JUDGED[data_set]])
    words = [word for value in values for word in known[value]]
    ends = np.cumsum([len(known[value]) for value in values]).tolist()
    rows = [list(range(end - len(known[value]), end)) for value, end in zip(values, ends, strict=True)]
    return Task(values, [attributes[value][0] for value in values], rows, clip.matrix(words))


@torch.inference_mode()
def confusion(
    embed: Embed, basis: Tensor, judged: Task, images: Sequence[Path], scale: float | None = None
) -> npt.NDArray[np.int64]:
    """Count pixels by true class (rows) and answered class (columns).

    Pictures are judged as the service sees them or, with a `scale`, at so many times their own size.
    """
    size = len(judged.values)
    index = np.full(256, -1)
    index[judged.values] = np.arange(size)
    vectors = torch.from_numpy(judged.vectors) @ basis
    counts = np.zeros((size, size), np.int64)
    for path in images:
        truth = index[read_labels(data.labels_of(path))]
        image = read_rgb(path)
        field = torch.from_numpy(embed(image, LONGEST if scale is None else scale * max(image.shape[:2])))
        cosines = torch.einsum("hwc,kc->khw", field, vectors)[None]
        best = torch.stack([cosines[:, rows].amax(dim=1) for rows in judged.rows], dim=1)
        best = F.interpolate(best, size=truth.shape, mode="bilinear", align_corners=False)
        answer = best.argmax(dim=1)[0].numpy()
        taught = truth >= 0
        counts += np.bincount(truth[taught] * size + answer[taught], minlength=size**2).reshape(size, size)
    return counts


def intersections_over_unions(counts: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Give each class's intersection over union, NaN for a class without pixels."""
    hits = np.diag(counts)
    unions = counts.sum(axis=0) + counts.sum(axis=1) - hits
    return np.where(counts.sum(axis=1) > 0, hits / np.maximum(unions, 1), np.nan)


def words_field(network: CompactNetwork) -> Embed:
    """The words field that descriptions are made of."""
    return lambda image, longest: _read(lambda x: network(x)[0], resized(image, longest))


def segmentation(
    network: CompactNetwork,
    fine: SegmentationNetwork,
    others: Sequence[IndependentSegmentationNetwork],
    vectors: Floats,
) -> Embed:
    """The segmentation network as the service makes them, with text vectors of the words that it knows."""
    members: list[Callable[[Tensor], Tensor]] = [lambda x: fine(*network.levels(x)), *others]
    return lambda image, longest: segment_with_ensemble(
        image, lambda seen, member: _read(members[member], seen), vectors, len(members), longest
    )


def _read(read: Callable[[Tensor], Tensor], pixels: Image) -> Floats:
    x = torch.from_numpy(pixels).permute(2, 0, 1)[None].float() / 255
    return np.asarray(read(x.contiguous(memory_format=torch.channels_last))[0].permute(1, 2, 0))


def segmentation_network_of(path: Path) -> SegmentationNetwork:
    """Load segmentation network to judge: a checkpoint's averaged weights (``.pt``) or an exported file."""
    return SegmentationNetwork.loaded(_state(path))


def second_of(path: Path) -> IndependentSegmentationNetwork:
    """Load second segmentation network to judge, from such files too."""
    return IndependentSegmentationNetwork.loaded(_state(path))


def _state(path: Path) -> dict[str, Tensor]:
    if path.suffix == ".pt":
        averaged: dict[str, Tensor] = torch.load(path, map_location="cpu", weights_only=True)["average"]
        return averaged
    return load_file(path)


def evaluate(
    embed: Embed, basis: Tensor, data_folder: Path, scale: float | None, *, split: str = "test", every: int = 1
) -> dict[str, dict[str, float]]:
    """Judge all sets: for each, the intersection over union of each class, and under ``mean`` their mean.

    `scale` is that of `confusion`.
    """
    segmentation = data_folder / "segmentation"
    clip = ClipWords(data_folder / data.CLIP_FILE)
    answers = {}
    for data_set in JUDGED:
        judged = task(segmentation, data_set, clip)
        images = data.images_of(segmentation, data_set, split)[::every]
        shares = intersections_over_unions(confusion(embed, basis, judged, images, scale))
        row = {name: round(float(share), 4) for name, share in zip(judged.names, shares, strict=True)}
        answers[data_set] = {"mean": round(float(np.nanmean(shares)), 4)} | row
    return answers


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.evaluate_segmentation", description="mIoU of the words."
    )
    parser.add_argument("--network", type=Path, required=True, help="checkpoint.pt or an exported .safetensors")
    parser.add_argument("--fine", type=Path, help="checkpoint.pt or an exported .safetensors of the fine words")
    parser.add_argument(
        "--second", type=Path, nargs="+", default=[], help="the same of the second fine words, and the third"
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--split", choices=("val", "test"), default="test")
    parser.add_argument("--every", type=int, default=1, help="judge every n-th picture only")
    parser.add_argument("--size", choices=("service", "own"), nargs="+", default=["service", "own"])
    parser.add_argument("--scale", type=float, default=1.0, help="enlarge pictures of their own size first")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args(arguments)
    if options.second and not options.fine:
        parser.error("--second FILE judges the mean with the first fine words: give --fine FILE too")
    if options.fine and options.network.suffix == ".pt":
        parser.error("fine words belong to an exported network: give its .safetensors as --network")
    keep_freed_memory()
    torch.set_num_threads(options.threads)
    network, basis = network_of(options.network), basis_of(options.network)
    if options.fine:
        others = [second_of(path) for path in options.second]
        vectors = load_file(options.network)["text.vectors"].float().numpy()
        embed = segmentation(network, segmentation_network_of(options.fine), others, vectors)
    else:
        embed = words_field(network)
    answers = {}
    for size in options.size:
        name, scale = (f"own x {options.scale:g}", options.scale) if size == "own" else (size, None)
        answers[name] = evaluate(embed, basis, options.data, scale, split=options.split, every=options.every)
    print(json.dumps(answers, indent=1))


if __name__ == "__main__":
    main()
