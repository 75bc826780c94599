"""``revisit loops``: find where a walk comes back to where it was, for a pose graph."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from app.cli import images
from app.cli.options import Verbs, add_service_options, integer, number, service_of
from app.cli.output import DONE, progress_bar, say, show, show_json, write_file, wrong_use

if TYPE_CHECKING:
    from revisit_client.loops import Keyframe, LoopCloser


OF_ONE_IMAGE = frozenset(
    (
        "conflict",
        "poor-picture",
        "nothing-static",
        "not-a-picture",
        "undecodable-picture",
        "picture-too-large",
        "picture-too-small",
        "body-too-large",
    )
)
"""Problems for which an image is left out of a walk; any other ends it."""


def add(verbs: Verbs) -> None:
    """Declare the command."""
    parser = verbs.add_parser(
        "loops",
        help="find where a walk comes back to where it was",
        description="Ask about each image of a walk in turn, then enrol it. Prints which images show the place of an "
        "earlier one; what was found when it is interrupted is written. docs/loops.md says how to read it.",
    )
    parser.add_argument(
        "paths", nargs="+", metavar="PATH", help="image, folder (all inside that is not hidden) or glob, in order"
    )
    parser.add_argument("--map", required=True, help="map of this walk alone")
    parser.add_argument(
        "--positions", type=Path, metavar="CSV", required=True, help="odometry: columns file, x, y and heading if known"
    )
    parser.add_argument(
        "--exclude-last",
        default="20",
        metavar="N|30s",
        help="newest images that are no loop: a number, or those enrolled in the last seconds (20)",
    )
    parser.add_argument(
        "--consistent",
        type=integer,
        metavar="N",
        help="images in a row that must agree (3; with --drive they add up)",
    )
    parser.add_argument("--within", type=number, metavar="METRES", help="look no further than this from the odometry")
    parser.add_argument("--radius", type=number, default=5.0, metavar="METRES", help="of a loop that has none (5)")
    parser.add_argument("--drive", metavar="NAME", help="count the images together, as those of this drive")
    parser.add_argument("--precision", type=number, metavar="P", help="share of loops that must be right")
    parser.add_argument("--g2o", type=Path, metavar="FILE", help="write the pose graph: odometry and loops")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write the loops as a table")
    add_service_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Find loops; returns 0 whether there are any or not. What was found is written also when it ends early."""
    from revisit_client.loops import LoopCloser

    walk = _walk(arguments)
    for file in (arguments.g2o, arguments.csv):
        if file is not None and (file.is_dir() or not file.absolute().parent.is_dir()):
            wrong_use(f"{file}: cannot be written; name a file in a folder that exists")
    with service_of(arguments) as revisit:
        try:
            closer = LoopCloser(
                revisit,
                arguments.map,
                exclude_last=arguments.exclude_last,
                consistent=arguments.consistent,
                within_m=arguments.within,
                radius_m=arguments.radius,
                drive=arguments.drive,
                precision=arguments.precision,
            )
        except ValueError as error:
            wrong_use(str(error))
        try:
            left_out = _follow(walk, closer, quiet=arguments.json)
        finally:
            _write(arguments, closer)
    if arguments.json:
        names = [path.name for path, _ in walk]
        listed = [vars(loop) | {"files": [names[loop.keyframe], names[loop.earlier]]} for loop in closer.loops]
        show_json({"keyframes": len(closer.keyframes), "loops": listed, "left_out": left_out})
    else:
        show(f"{len(closer.loops)} loops among {len(closer.keyframes)} images")
        for one in left_out:
            say(f"  left out {one['file']}: {one['reason']}")
    return DONE


def _follow(walk: "Sequence[tuple[Path, Keyframe]]", closer: "LoopCloser", *, quiet: bool) -> list[dict[str, str]]:
    """Go through a walk, and tell each loop as soon as it is certain; returns which images were left out, and why."""
    from revisit_client import RevisitProblem

    left_out = []
    with progress_bar(len(walk), "images", quiet=quiet) as step:
        for path, keyframe in walk:
            try:
                loops = closer.add(path, keyframe)
            except RevisitProblem as problem:  # such as a frame that was saved twice, or a black one
                if problem.code not in OF_ONE_IMAGE or not closer.keyframes:
                    raise
                left_out.append({"file": str(path), "reason": str(problem)})
                loops = []
            for loop in loops:
                if not quiet:
                    where = f"{walk[loop.keyframe][0].name} is where {walk[loop.earlier][0].name} was"
                    show(f"{where} (confidence {loop.confidence:.2f}, within {loop.radius_m:.1f} m)")
            step(path.name)
    return left_out


def _write(arguments: argparse.Namespace, closer: "LoopCloser") -> None:
    """The files asked for, as far as the walk came; none before its first image."""
    from revisit_client.loops import csv, g2o

    if not closer.keyframes:
        return
    for file, text in (
        (arguments.g2o, g2o(closer.keyframes, closer.loops)),
        (arguments.csv, csv(closer.loops, closer.keyframes)),
    ):
        if file is not None:
            write_file(file, text.encode())
            say(f"written: {file} ({len(closer.keyframes)} keyframes)")


def _walk(arguments: argparse.Namespace) -> "list[tuple[Path, Keyframe]]":
    """The images in order, each as a keyframe; raises Failure where one has no position in metres."""
    from revisit_client.loops import Keyframe

    positions = images.Positions(arguments.positions)
    walk = []
    for order, path in enumerate(images.find(arguments.paths)):
        known = positions.of(path) or {}
        if "x" not in known or "y" not in known:
            wrong_use(f"{path}: {arguments.positions} says no x and y of it")
        walk.append((path, Keyframe(order, known["x"], known["y"], known.get("heading"))))
    return walk
