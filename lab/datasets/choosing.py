"""Data sets as the command line names them: arguments, and what they read."""

import argparse
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from lab.datasets import aligned, folder, kitti, pairs, pitts30k, tutorial, utm_names
from lab.datasets.dataset import RADIUS_M, Dataset
from lab.datasets.hold_out import hold_out
from schemas.errors import InvalidParameters

PROTOCOLS = {
    "kitti": ("loop", "halves"),
    "pairs": ("vpr-tutorial",),
    "aligned": ("vpr-tutorial",),
    "folder": ("utm",),
}
"""Ways of reading or judging a data set, by its name; of kitti the first is the default."""


def chosen(datasets: Sequence[Dataset], beginnings: str, *, walks: bool = False) -> list[Dataset]:
    """Sets whose names begin with one of some texts, comma-separated; of these the walks, if only they are wanted.

    Raises
    ------
    InvalidParameters
        There are none.
    """
    found = [one for one in datasets if one.name.startswith(tuple(beginnings.split(",")))]
    names = ", ".join(one.name for one in datasets)
    if not found:
        raise InvalidParameters.of("sets", f"{beginnings} begins no name of {names}")
    if walks and not any(one.sequential for one in found):
        raise InvalidParameters.of("sets", f"no walk, whose neighbouring queries share right answers, is among {names}")
    return [one for one in found if one.sequential or not walks]


def add_device(parser: argparse.ArgumentParser) -> None:
    """Where networks run."""
    parser.add_argument("--device", default="cpu", help="where networks run: cpu, cuda, ... (default: cpu)")


def whole(least: int) -> Callable[[str], int]:
    """A reader of whole numbers that are so large at least."""

    def number(text: str) -> int:
        if not text.strip().isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text!r} is no whole number of {least} or more")
        return int(text)

    return number


def _named(text: str) -> Path:
    """A folder that has a name, which sets are called by: ``.`` is the one that it stands for."""
    folder = Path(text)
    return folder if folder.name not in ("", "..") else folder.resolve()


def _metres(text: str) -> float:
    return _between(text, math.nextafter(0, 1), math.inf, "no distance above 0 in metres")


def _degrees(text: str) -> float:
    return _between(text, 0, 180, "no angle of 0 to 180 degrees")


def _share(text: str) -> float:
    return _between(text, 0, math.nextafter(1, 0), "no share of 0 or more and below 1")


def _between(text: str, least: float, most: float, otherwise: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and least <= value <= most):
        raise argparse.ArgumentTypeError(f"{text!r} is {otherwise}")
    return value


def add_dataset_arguments(parser: argparse.ArgumentParser) -> None:
    """What `read` understands, the seed of whatever is drawn included."""
    parser.add_argument(
        "dataset", choices=["kitti", "pitts30k", "pairs", "aligned", "folder"], help="layout: docs/evaluation.md"
    )
    parser.add_argument("--root", type=_named, required=True, help="folder of the data set")
    parser.add_argument("--seed", type=whole(0), default=0, help="of whatever is drawn at random (default: 0)")
    parser.add_argument(
        "--protocol",
        choices=sorted({name for names in PROTOCOLS.values() for name in names}),
        help="kitti: loop (default) or halves; pairs, aligned: vpr-tutorial (frame for frame, 8 either way ignored); "
        "folder: utm (positions in names, @easting@northing@...)",
    )
    parser.add_argument(
        "--radius",
        type=_metres,
        default=RADIUS_M,
        help=f"metres within which an answer is right (default: {RADIUS_M:g})",
    )
    parser.add_argument("--hold-out", type=_share, default=0.0, help="share of queries whose places are not enrolled")
    one = parser.add_argument_group("kitti")
    one.add_argument("--sequence", default="00", help="which one (default: 00)")
    one.add_argument(
        "--gap", type=whole(0), default=100, help="frames between a query and the newest it may know (default: 100)"
    )
    one.add_argument("--every", type=whole(1), default=1, help="use every n-th frame")
    one.add_argument("--camera", default="image_2", help="folder of its images (default: image_2)")
    two = parser.add_argument_group("pitts30k")
    two.add_argument("--split", choices=["train", "val", "test"], default="val", help="which one (default: val)")
    two.add_argument("--queries", type=whole(1), help="draw this many queries")
    two.add_argument("--database", type=whole(1), help="draw this many database images, distractors included")
    rest = parser.add_argument_group("pairs, aligned, folder")
    rest.add_argument("--unlisted", action="store_true", help="query images that no row names too, as unanswerable")
    rest.add_argument(
        "--tolerance", type=whole(0), default=2, help="frames by which an aligned answer may differ (default: 2)"
    )
    rest.add_argument("--heading", type=_degrees, help="degrees by which the heading may differ")


def read(name: str, options: argparse.Namespace) -> list[Dataset]:
    """The data sets that the command line asks for; raises UnexpectedLayout and InvalidParameters."""
    root: Path = options.root
    protocol: str | None = options.protocol
    if protocol is not None and protocol not in PROTOCOLS.get(name, ()):
        there = ", ".join(PROTOCOLS.get(name, ())) or "none"
        raise InvalidParameters.of("protocol", f"{protocol} is none of {name}'s; there are: {there}")
    if protocol == "vpr-tutorial" and options.hold_out:
        raise InvalidParameters.of("hold-out", "vpr-tutorial judges frame for frame: nothing can be held out of it")
    if name == "kitti":
        found = kitti.read(
            root,
            sequence=options.sequence,
            protocol="halves" if protocol == "halves" else "loop",
            radius_m=options.radius,
            gap=options.gap,
            every=options.every,
            camera=options.camera,
        )
    elif name == "pitts30k":
        limits = {"queries": options.queries, "database": options.database}
        found = pitts30k.read(root, split=options.split, radius_m=options.radius, seed=options.seed, **limits)
    elif name == "pairs":
        found = pairs.read(root, unlisted=options.unlisted)
    elif name == "aligned":
        found = aligned.read(root, tolerance=options.tolerance)
    elif protocol == "utm":
        found = utm_names.read(root, radius_m=options.radius)
    else:
        found = folder.read(root, radius_m=options.radius, heading_tolerance=options.heading)
    if protocol == "vpr-tutorial":
        found = [tutorial.diagonal(dataset) for dataset in found]
    if options.hold_out:
        rng = np.random.default_rng(options.seed)
        try:
            found = [hold_out(dataset, options.hold_out, rng) for dataset in found]
        except ValueError as reason:
            raise InvalidParameters.of("hold-out", str(reason)) from None
    return found
