"""Mean IoU of a network's labels: ``python -m training.commands.evaluate_segmentation --network FILE --data DATA``.

As LSeg is judged: each pixel is given the class whose best text label is nearest to the pixel's embedding, among the
classes of its data set. CamVid has 11 classes and LabelMeFacade 8; of NYUv2's 37 the 13 with most labelled pixels in
its training images are judged, and pixels of the others are left out.

What is judged is the segmentation ensemble with ``--members FILES``, as the service has it, and without that option the
semantic field that descriptions are made of. Images are judged at two sizes: as the service sees them, 480 pixels on
the longer side (``service``), and at their own size times ``--scale`` (``original``). Scores are interpolated to the
size of the label map before the best class is taken.
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

from schemas.description import Floats
from schemas.image import Image
from training.data.images import Pixels, read_labels, read_rgb
from training.data.lexicon import ClipVectors, read_classes
from training.data.sources import CLIP_FILE, images_of, labels_of, training_images
from training.models.checkpoints import load_basis, load_independent_network, load_network, load_segmentation_network
from worker.configure import keep_freed_memory
from worker.encoders.compact.ensemble import prepared, segment_with_ensemble
from worker.encoders.compact.input_size import LONGEST, resized
from worker.encoders.compact.network import CompactNetwork
from worker.encoders.compact.segmentation import IndependentSegmentationNetwork, SegmentationNetwork

JUDGED = {"camvid": 11, "labelmefacade": 8, "nyuv2": 13}
"""Data sets, and how many of their classes are judged: those with most labelled pixels."""

Embed = Callable[[Pixels, float], Floats]
"""From an image, uint8 (height, width, 3), and its longer side as judged, to float32 (rows, columns, channels)."""


@dataclass(frozen=True)
class Task:
    """The classes of one data set that are judged.

    Attributes
    ----------
    values : list of int
        In label maps.
    names : list of str
    rows : list of list of int
        For each class, the rows of `vectors` that belong to its labels.
    vectors : float32 of shape (n_labels, 512)
    """

    values: list[int]
    names: list[str]
    rows: list[list[int]]
    vectors: Floats


def task_of(segmentation: Path, data_set: str, clip: ClipVectors) -> Task:
    """Choose the classes of a data set that are judged, and find the vectors of their labels."""
    classes = read_classes(segmentation / data_set / "classes.json")
    counts = np.zeros(256)
    for path in training_images(segmentation, data_set)[::4]:
        counts += np.bincount(read_labels(labels_of(path)).ravel(), minlength=256)
    known = {value: [label for label in labels if clip.sources(label)] for value, labels in classes.items()}
    common = sorted((value for value in known if known[value]), key=lambda value: -counts[value])
    values = sorted(common[: JUDGED[data_set]])
    labels = [label for value in values for label in known[value]]
    ends = np.cumsum([len(known[value]) for value in values]).tolist()
    rows = [list(range(end - len(known[value]), end)) for value, end in zip(values, ends, strict=True)]
    return Task(values, [classes[value][0] for value in values], rows, clip.matrix(labels))


@torch.inference_mode()
def confusion(
    embed: Embed, basis: Tensor, task: Task, images: Sequence[Path], scale: float | None = None
) -> npt.NDArray[np.int64]:
    """Count pixels by true class (rows) and predicted class (columns).

    Parameters
    ----------
    embed : function
    basis : float of shape (512, channels)
        Turns vectors of the task into the space of the embeddings.
    task : Task
    images : sequence of Path
    scale : float or None
        Judge images at so many times their own size; None: at the size that the service sees.

    Returns
    -------
    int64 of shape (n_classes, n_classes)
    """
    size = len(task.values)
    index = np.full(256, -1)
    index[task.values] = np.arange(size)
    vectors = torch.from_numpy(task.vectors) @ basis
    counts = np.zeros((size, size), np.int64)
    for path in images:
        truth = index[read_labels(labels_of(path))]
        image = read_rgb(path)
        field = torch.from_numpy(embed(image, LONGEST if scale is None else scale * max(image.shape[:2])))
        cosines = torch.einsum("hwc,kc->khw", field, vectors)[None]
        best = torch.stack([cosines[:, rows].amax(dim=1) for rows in task.rows], dim=1)
        best = F.interpolate(best, size=truth.shape, mode="bilinear", align_corners=False)
        predicted = best.argmax(dim=1)[0].numpy()
        judged = truth >= 0
        counts += np.bincount(truth[judged] * size + predicted[judged], minlength=size**2).reshape(size, size)
    return counts


def class_ious(counts: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Intersection over union of each class, from `confusion`; NaN for a class without pixels."""
    hits = np.diag(counts)
    unions = counts.sum(axis=0) + counts.sum(axis=1) - hits
    return np.where(counts.sum(axis=1) > 0, hits / np.maximum(unions, 1), np.nan)


def semantic_field(network: CompactNetwork) -> Embed:
    """Embed by the semantic field that descriptions are made of."""
    return lambda image, longest: _run(lambda x: network(x)[0], resized(image, longest))


def ensemble(
    network: CompactNetwork,
    first: SegmentationNetwork,
    others: Sequence[IndependentSegmentationNetwork],
    vectors: Floats,
) -> Embed:
    """Embed by the segmentation ensemble as the service does.

    Parameters
    ----------
    network : CompactNetwork
        Its shallow layers are those of the first member.
    first : SegmentationNetwork
    others : sequence of IndependentSegmentationNetwork
    vectors : float32 of shape (n_labels, channels)
        Of all labels that ship: a member's weight depends on how near its embeddings are to some label.
    """
    members: list[Callable[[Tensor], Tensor]] = [lambda x: first(*network.levels(x)), *others]
    return lambda image, longest: segment_with_ensemble(
        prepared(Image.of(image), len(members), longest),
        lambda pixels, member: _run(members[member], pixels),
        vectors,
        len(members),
    )


def _run(network: Callable[[Tensor], Tensor], pixels: Pixels) -> Floats:
    x = torch.from_numpy(pixels).permute(2, 0, 1)[None].float() / 255
    return np.asarray(network(x.contiguous(memory_format=torch.channels_last))[0].permute(1, 2, 0))


def evaluate(
    embed: Embed, basis: Tensor, data_folder: Path, scale: float | None, *, split: str = "test", every: int = 1
) -> dict[str, dict[str, float]]:
    """Judge all data sets: for each, the IoU of every class, and their mean under ``mean``.

    Parameters
    ----------
    embed, basis, scale
        As for `confusion`.
    data_folder : Path
    split : str
        ``val`` or ``test``.
    every : int
        Judge one image in so many.
    """
    segmentation = data_folder / "segmentation"
    clip = ClipVectors(data_folder / CLIP_FILE)
    results = {}
    for data_set in JUDGED:
        task = task_of(segmentation, data_set, clip)
        images = images_of(segmentation, data_set, split)[::every]
        ious = class_ious(confusion(embed, basis, task, images, scale))
        row = {name: round(float(iou), 4) for name, iou in zip(task.names, ious, strict=True)}
        results[data_set] = {"mean": round(float(np.nanmean(ious)), 4)} | row
    return results


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the IoUs as JSON."""
    parser = argparse.ArgumentParser(
        prog="python -m training.commands.evaluate_segmentation", description="Mean IoU of a network's labels."
    )
    parser.add_argument("--network", type=Path, required=True, help="checkpoint.pt or an exported .safetensors")
    parser.add_argument(
        "--members",
        type=Path,
        nargs="+",
        help="judge the ensemble: the member that shares layers with the network, then the independent ones",
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--split", choices=("val", "test"), default="test")
    parser.add_argument("--every", type=int, default=1, help="judge one image in so many")
    parser.add_argument("--size", choices=("service", "original"), nargs="+", default=["service", "original"])
    parser.add_argument("--scale", type=float, default=1.0, help="enlarge images of their original size so many times")
    parser.add_argument("--threads", type=int, default=1)
    options = parser.parse_args(arguments)
    if options.members and options.network.suffix == ".pt":
        parser.error("--members belong to an exported network: give its .safetensors as --network")
    keep_freed_memory()
    torch.set_num_threads(options.threads)
    network, basis = load_network(options.network), load_basis(options.network)
    if options.members:
        first, *others = options.members
        vectors = load_file(options.network)["text.vectors"].float().numpy()
        independent = [load_independent_network(path) for path in others]
        embed = ensemble(network, load_segmentation_network(first), independent, vectors)
    else:
        embed = semantic_field(network)
    results = {}
    for size in options.size:
        name, scale = (f"original x {options.scale:g}", options.scale) if size == "original" else (size, None)
        results[name] = evaluate(embed, basis, options.data, scale, split=options.split, every=options.every)
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
