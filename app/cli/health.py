"""``revisit health``: what a map lacks or suffers from, and what to do about it."""

import argparse

from app.cli.options import Verbs, add_service_options, integer, service_of
from app.cli.output import DONE, say, show, show_json


def add(verbs: Verbs) -> None:
    """Declare the command."""
    parser = verbs.add_parser(
        "health",
        help="places that a map confuses, places that age, duplicates, directions and stretches without views",
        description="What makes a map's answers wrong or missing, and what to do about it.",
    )
    parser.add_argument("map", nargs="?", default="default", help="which map (default: default)")
    parser.add_argument(
        "--code",
        choices=("twins", "ageing", "never-matched", "duplicates", "missing-directions", "single-view", "gap"),
        help="findings of this kind alone",
    )
    parser.add_argument("--limit", type=integer, metavar="N", help="at most so many of each kind (default: 20)")
    add_service_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print the findings."""

    with service_of(arguments) as revisit:
        health = revisit.health(arguments.map, code=arguments.code, limit=arguments.limit)
    if arguments.json:
        show_json(health)
        return DONE
    for finding in health.findings:
        show(f"{finding.code}: {finding.detail}\n    {finding.remedy}")
        if finding.views:
            show(f"    views: {', '.join(finding.views)}")
    counts = ", ".join(f"{count} {code}" for code, count in health.counts.items() if count)
    say(
        f"{health.map}: {counts or 'nothing found'}; {health.examined} of {health.views} views examined, "
        f"{health.compared} compared with the others"
    )
    return DONE
