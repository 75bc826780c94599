"""``revisit privacy``: what a map keeps of images and queries, and what it blurs."""

import argparse
from typing import TYPE_CHECKING

from app.cli.options import Verbs, add_service_options, service_of
from app.cli.output import DONE, show, show_json

if TYPE_CHECKING:
    from revisit_client.wire import MapFacts


def add(verbs: Verbs) -> None:
    """Declare the command."""
    parser = verbs.add_parser(
        "privacy",
        help="what a map keeps of images, and what it blurs in them",
        description="Show or change what a map blurs in images before they are stored, and whether it keeps them.",
    )
    parser.add_argument("map", nargs="?", default="default", help="which map (default: default)")
    parser.add_argument(
        "--blur",
        metavar="WORD,...",
        help="people, vehicles or labels, covered from the map's first view on; empty: nothing",
    )
    parser.add_argument("--drop-images", action="store_true", help="remove all images, for good, once described")
    add_service_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Change what is asked, then show what the map keeps."""

    words = None if arguments.blur is None else [word.strip() for word in arguments.blur.split(",") if word.strip()]
    drop = False if arguments.drop_images else None
    with service_of(arguments) as revisit:
        if words is None and drop is None:
            facts = revisit.map(arguments.map)
        else:
            facts = revisit.change_map(arguments.map, blur=words, keep_images=drop)
    if arguments.json:
        kept = ("name", "blur", "keep_images", "keep_queries", "keep_matches")
        show_json({name: getattr(facts, name) for name in kept})
    else:
        show("\n".join(_text(facts)))
    return DONE


def _text(facts: "MapFacts") -> list[str]:
    blurred = f", {' and '.join(facts.blur)} blurred as far as they are found" if facts.blur else ", as they are sent"
    return [
        f"{facts.name}: images are {'kept' + blurred if facts.keep_images else 'removed once they are described'}",
        f"    queries that matched nothing: {_most(facts.keep_queries)}",
        f"    queries that look unlike what they matched: {_most(facts.keep_matches)}",
    ]


def _most(count: int) -> str:
    return f"the newest {count:,} are kept" if count else "none is kept"
