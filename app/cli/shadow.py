"""``revisit shadow``: what a recipe that is tried beside that of a map changes; switch to it, or discard it."""

import argparse
from typing import TYPE_CHECKING

from app.cli.options import Verbs, add_service_options, service_of
from app.cli.output import DONE, show, show_json, table

if TYPE_CHECKING:
    from revisit_client import Revisit
    from revisit_client.wire import Shadow, ShadowAnswer, ShadowTable

ROWS = 20
"""Queries that are listed without `--all`."""


def add(verbs: Verbs) -> None:
    """Declare the command."""
    parser = verbs.add_parser(
        "shadow",
        help="what a recipe that is tried beside a map's own changes: switch to it, or discard it",
        description="The shadow of a map, which `revisit recipe --shadow` begins: another recipe describes the views "
        "beside the present one, and both answer the last kept queries. The map changes over only when told.",
    )
    parser.add_argument("--map", default="default", help="which map (default: default)")
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--switch", action="store_true", help="change the map over to it")
    what.add_argument("--discard", action="store_true", help="discard it: the map keeps its recipe")
    what.add_argument("--all", action="store_true", help=f"list all queries, not the first {ROWS} that do not agree")
    add_service_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Show the shadow of a map, switch to it, or discard it."""

    with service_of(arguments) as revisit:
        if arguments.switch or arguments.discard:
            return _decided(revisit, arguments)
        found = revisit.shadow(arguments.map)
    if arguments.json:
        show_json(found)
    else:
        show_shadow(found, everything=arguments.all)
    return DONE


def _decided(revisit: "Revisit", arguments: argparse.Namespace) -> int:
    if arguments.switch:
        job = revisit.wait_for_job(revisit.switch_to_shadow(arguments.map).id, timeout=3600)
    else:
        job = revisit.discard_shadow(arguments.map)
    if arguments.json:
        show_json(job)
    elif arguments.switch:
        show(f"map {job.map} has changed over to its shadow")
    else:
        show(f"the shadow of map {job.map} is discarded")
    return DONE


def show_shadow(found: "Shadow", *, everything: bool = False) -> None:
    """Print a shadow, and its table when it is ready."""
    if found.table is None:
        progress = "" if found.progress is None else f", {found.progress.done} of {found.progress.total} images"
        show(f"shadow of map {found.map}: {found.state}{progress}")
        return
    show_table(found.table, everything=everything)
    show(f"`./revisit shadow --map {found.map} --switch` changes over, `--discard` keeps the recipe")


def show_table(of: "ShadowTable", *, everything: bool = False) -> None:
    """Print the totals of a table, and its rows."""
    totals = of.totals
    show(
        f"{totals.queries} queries, {totals.kept} kept ones and {totals.views} views of the map; "
        f"{totals.agree} agree, {totals.changed_first} have another first place, {totals.became_matched} became "
        f"matched, {totals.stopped_matching} are matched no longer\n"
    )
    heads = ("recipe", "views", "matched", "ambiguous", "no match", "refused", "right", "search ms", "describe ms")
    sides = (
        (
            name,
            views,
            side.matched,
            side.ambiguous,
            side.no_match,
            side.refused,
            f"{side.right} of {totals.known}",
            side.search_ms,
            side.describe_ms,
        )
        for name, views, side in (("old", of.old_views, totals.old), ("new", of.new_views, totals.new))
    )
    show(table(heads, list(sides)))
    rows = of.queries if everything else [one for one in of.queries if not one.agree][:ROWS]
    if rows:
        listed = [(one.id, one.place, _answer(one.old), _answer(one.new), one.agree) for one in rows]
        show("\n" + table(("query", "of place", "old", "new", "agree"), listed))


def _answer(one: "ShadowAnswer") -> str:
    first = one.place or one.view or "nothing"
    return f"{one.status} {one.confidence:.2f}: {first}"
