"""``revisit query``: recognise the place of an image."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from app.cli.changes import changes_text
from app.cli.filters import add_filter_options, filters_of
from app.cli.options import Verbs, add_service_options, integer, number, service_of
from app.cli.output import DONE, say, show, show_json, table, write_file

if TYPE_CHECKING:
    from revisit_client.wire import Match, Position, QueryAnswer

VERDICTS = {
    "matched": "This place is known.",
    "ambiguous": "Not sure whether this place is known.",
    "no_match": "This place is not known.",
}


def add(verbs: Verbs) -> None:
    """Declare the command."""
    parser = verbs.add_parser("query", help="find where an image was taken")
    parser.add_argument("image", type=Path, metavar="IMAGE", help="file of the photo")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--map", help="map to search (default: default)")
    where.add_argument("--maps", metavar="A,B", help="several maps to search: one verdict over all of them")
    parser.add_argument("--top", type=integer, metavar="N", help="how many matches (default: 5)")
    parser.add_argument("--candidates", type=integer, metavar="N", help="candidates of each channel to re-rank")
    parser.add_argument("--precision", type=number, metavar="P", help="share of `matched` that must be right")
    parser.add_argument(
        "--zoom", type=number, metavar="Z", help="how many times as large the image's camera shows things as the map's"
    )
    parser.add_argument("--roll", type=number, metavar="DEGREES", help="by which the camera was turned clockwise")
    parser.add_argument("--drive", metavar="NAME", help="the image is the next one of this drive")
    parser.add_argument(
        "--drive-timeout", type=number, metavar="S", help="seconds of silence after which the drive begins anew (60)"
    )
    parser.add_argument("--consistent", type=integer, metavar="N", help="images of the drive in a row that must agree")
    add_filter_options(parser)
    parser.add_argument("--explain", type=Path, metavar="PNG", help="draw the explanation of the best match")
    parser.add_argument("--changes", type=Path, metavar="PNG", help="say and draw what changed since the best match")
    add_service_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Query; returns 0 whether the place is known or not."""

    filters = filters_of(arguments)
    with service_of(arguments) as revisit:
        answer = revisit.query(
            arguments.image,
            map=arguments.map,
            maps=None if arguments.maps is None else arguments.maps.split(","),
            top=arguments.top,
            candidates=arguments.candidates,
            precision=arguments.precision,
            zoom=arguments.zoom,
            roll=arguments.roll,
            explain=arguments.explain is not None,
            changes=arguments.changes is not None or None,
            drive=arguments.drive,
            drive_timeout=arguments.drive_timeout,
            consistent=arguments.consistent,
            **filters,
        )
        if arguments.json:  # before anything is written: a mistyped folder is no reason to lose the answer
            show_json(answer)
        else:
            show(answer_text(answer))
        if arguments.explain is not None and answer.matches:
            write_file(arguments.explain, revisit.explanation(answer.query.id))
            say(f"explanation: {arguments.explain}")
        if answer.changes is not None and answer.changes.links:
            write_file(arguments.changes, revisit.draw_changes_of_query(answer.query.id))
            say(f"changes: {arguments.changes}")
    return DONE


def answer_text(answer: "QueryAnswer") -> str:
    """The answer as text."""
    lines = [f"{VERDICTS[answer.status]} (confidence {answer.confidence:.2f}, {answer.searched} views searched)"]
    if answer.reason.code != "sure" or answer.status != "matched":
        lines.append(f"{answer.reason.code}: {answer.reason.detail}; {answer.reason.remedy}")
    if answer.drive is not None:
        alone, agree = answer.drive.single_frame_status, answer.drive.agreeing
        lines.append(f"drive: image {answer.drive.images}, {agree} in a row agree; this image alone: {alone}")
    if answer.reason.rival is not None:
        rival = answer.reason.rival
        of = "" if answer.maps is None else f"{rival.view.map}: "
        lines.append(f"rival: {of}{rival.view.place or rival.view.filename or rival.view.id}, score {rival.score:.3f}")
    if answer.maps is not None:
        maps = [(one.map, one.probability, one.searched) for one in answer.maps]
        lines.append(table(("map", "probability", "views"), maps))
    if answer.matches:
        heads: tuple[str, ...] = ("rank", "place", "score", "confidence", "inliers", "position", "file", "view")
        if answer.maps is not None:
            heads = (*heads, "map")
        rows = [(*_row(match), match.view.map)[: len(heads)] for match in answer.matches]
        lines.append(table(heads, rows))
    if answer.estimate is not None:
        where = position_text(answer.estimate.position)
        radius = answer.estimate.radius_m
        within = "" if radius is None else f", within {radius:.1f} m"
        lines.append(f"taken at {where}{within} ({len(answer.estimate.views)} views)")
    if answer.changes is not None:
        lines.append(changes_text(answer.changes))
    if (total := answer.timing_ms.get("total")) is not None:
        lines.append(f"{total:.0f} ms")
    return "\n".join(lines)


def _row(match: "Match") -> tuple[object, ...]:
    inliers = None if match.verification is None else match.verification.inliers
    return (
        match.rank,
        match.view.place,
        match.score,
        match.confidence,
        inliers,
        position_text(match.view.position),
        match.view.filename,
        match.view.id,
    )


def position_text(position: "Position | None") -> str | None:
    """A position as text; None without one."""
    if position is None:
        return None
    if position.lat is not None and position.lon is not None:
        return f"{position.lat:.6f}°, {position.lon:.6f}°"
    if position.x is not None and position.y is not None:
        return f"{position.x:.2f}, {position.y:.2f} m"
    return None
