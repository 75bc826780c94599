"""``revisit changes``: what is gone, new or moved between two views of a place."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from app.cli.options import Verbs, add_service_options, service_of
from app.cli.output import DONE, say, show, show_json, table, write_file

if TYPE_CHECKING:
    from revisit_client.wire import Changes, Spot


def add(verbs: Verbs) -> None:
    """Declare the command."""
    parser = verbs.add_parser("changes", help="say what changed between two views of a place")
    parser.add_argument("view", metavar="VIEW", help="id of the later view")
    parser.add_argument("--since", required=True, metavar="VIEW", help="id of the earlier view")
    parser.add_argument("--drawing", type=Path, metavar="PNG", help="draw both, with what changed outlined")
    add_service_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Compare two views."""

    with service_of(arguments) as revisit:
        changes = revisit.changes(arguments.view, arguments.since)
        if arguments.drawing is not None:
            write_file(arguments.drawing, revisit.draw_changes(arguments.view, arguments.since))
            say(f"changes: {arguments.drawing}")
    if arguments.json:
        show_json(changes)
    else:
        show(changes_text(changes))
    return DONE


def changes_text(changes: "Changes") -> str:
    """What changed at a place, as text."""
    if changes.status != "compared":
        return f"changes: {changes.status}: {changes.detail}"
    share = f"{100 * changes.compared:.0f} % of the photo could be compared"
    if not changes.changes:
        return f"nothing changed that could be told; {share}"
    heads = ("change", "thing", "other photo", "confidence", "then at", "now at", "share")
    rows = [
        (one.kind, one.label, one.instead, one.confidence, _at(one.then), _at(one.now), _share(one.now or one.then))
        for one in changes.changes
    ]
    return f"changed since then; {share}\n{table(heads, rows)}"


def _at(spot: "Spot | None") -> str | None:
    return None if spot is None else f"{spot.centre[0]:.2f}, {spot.centre[1]:.2f}"


def _share(spot: "Spot | None") -> str | None:
    return None if spot is None else f"{100 * spot.share:.1f} %"
