"""Options of `query` and `views` that filter views."""

import argparse
import re
from collections.abc import Sequence
from typing import Any

from app.cli.options import number
from app.cli.output import wrong_use

_POINT = re.compile(r"-[\d.][^\s]*,\S*")


def add_filter_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that filter views."""
    parser.add_argument("--place", help="views of this place only")
    parser.add_argument("--near", metavar="X,Y,RADIUS", help="views near this point only; or LAT,LON,RADIUS")
    frame = parser.add_mutually_exclusive_group()
    frame.add_argument("--geo", dest="geographic", action="store_true", default=None, help="--near is in degrees")
    frame.add_argument("--metric", dest="geographic", action="store_false", help="--near is in metres")
    parser.add_argument("--after", metavar="TIME", help="views captured then or later, such as 2026-03-01T09:30:00Z")
    parser.add_argument("--before", metavar="TIME", help="views captured then or earlier")
    parser.add_argument(
        "--metadata", metavar="KEY=VALUE", action="append", default=[], help="views with this value; may be repeated"
    )
    parser.add_argument(
        "--where", metavar="JSON", help='views of which this holds, such as {"metadata.floor": {"$gte": 2}}'
    )
    parser.add_argument("--exclude-last", metavar="N|30s", help="leave out the newest N views, or seconds")
    parser.add_argument("--exclude", metavar="ID,...", help="leave out these views")


def filters_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """The options as arguments of `Revisit.query` and `Revisit.views`; raises Failure (exit code 2)."""
    if arguments.geographic is not None and arguments.near is None:
        wrong_use("--geo and --metric say what --near is: give that too")
    return {
        "place": arguments.place,
        "near": None if arguments.near is None else _near(arguments.near),
        "geographic": arguments.geographic,
        "after": arguments.after,
        "before": arguments.before,
        "metadata": dict(map(_pair, arguments.metadata)),
        "where": arguments.where,
        "exclude_last": arguments.exclude_last,
        "exclude": [one.strip() for one in (arguments.exclude or "").split(",") if one.strip()],
    }


def points_joined(argv: Sequence[str]) -> list[str]:
    """Arguments in which ``--near -27.4,153,50`` is ``--near=-27.4,153,50``: argparse would take it for an option."""
    joined: list[str] = []
    for word in argv:
        if joined and joined[-1] == "--near" and _POINT.fullmatch(word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _near(text: str) -> tuple[float, float, float]:
    try:
        first, second, radius = map(number, text.split(","))
    except (ValueError, argparse.ArgumentTypeError):
        wrong_use(f"--near takes three numbers with commas between, not {text!r}")
    return first, second, radius


def _pair(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not key or not equals:
        wrong_use(f"--metadata takes KEY=VALUE, not {text!r}")
    return key, value
