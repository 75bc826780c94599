"""``revisit maps | views | places``: list, show and delete maps and views, list places."""

import argparse
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from app.cli.filters import add_filter_options, filters_of
from app.cli.options import Verbs, add_service_options, integer, json_object, service_of
from app.cli.output import DONE, say, show, show_json, size, table, write_file, wrong_use

if TYPE_CHECKING:
    from revisit_client import Revisit
    from revisit_client.wire import Deleted, View

LISTED = 50
"""Views that are listed without `--limit`."""


def add(verbs: Verbs) -> None:
    """Declare the commands."""
    maps = verbs.add_parser("maps", help="list maps, or show one")
    maps.add_argument("name", nargs="?", help="show this map with its labels and recipe")
    maps.add_argument("--delete", action="store_true", help="delete the named map with all its views")
    maps.add_argument(
        "--refuse-poor",
        choices=("yes", "no"),
        help="whether the named map refuses images that are dark, overexposed, covered or blurred, show mostly what "
        "moves, or are nearly in it already",
    )
    add_service_options(maps)
    maps.set_defaults(run=run_maps)

    views = verbs.add_parser("views", help="list views, show, change or delete one")
    views.add_argument("id", nargs="?", help="show this view")
    views.add_argument("--map", help="of this map alone")
    add_filter_options(views)
    views.add_argument("--words", help="labels such as fence,pole+sign: views of --map by how much of them these are")
    views.add_argument("--state", choices=("pending", "ready", "failed"), help="of this state alone")
    views.add_argument("--limit", type=integer, metavar="N", help=f"at most so many (default: {LISTED})")
    views.add_argument("--newest", action="store_true", help="newest first")
    views.add_argument(
        "--delete",
        action="store_true",
        help="delete the named view and its image; or all views of --map that pass the filters",
    )
    views.add_argument(
        "--set",
        metavar="JSON",
        help='change the named view: {"place": "hall", "x": 1.5, "metadata": {"floor": 2}}; null removes',
    )
    for kind in ("image", "segmentation", "graph"):
        views.add_argument(f"--{kind}", type=Path, metavar="FILE", help=f"write the named view's {kind} to a file")
    add_service_options(views)
    views.set_defaults(run=run_views)

    places = verbs.add_parser("places", help="list places")
    places.add_argument("--map", help="of this map alone")
    add_service_options(places)
    places.set_defaults(run=run_places)


def run_maps(arguments: argparse.Namespace) -> int:
    """List maps, or show, change or delete one."""

    if arguments.name is None and (arguments.delete or arguments.refuse_poor is not None):
        wrong_use("--delete and --refuse-poor need the name of a map")
    if arguments.delete and arguments.refuse_poor is not None:
        wrong_use("--delete and --refuse-poor exclude each other")
    with service_of(arguments) as revisit:
        if arguments.delete:
            receipt = revisit.delete_map(arguments.name)
            return _deleted(arguments, receipt, f"{arguments.name}: {receipt.views} views, {receipt.images} images")
        if arguments.refuse_poor is not None:
            maps = [revisit.change_map(arguments.name, refuse_poor=arguments.refuse_poor == "yes")]
        else:
            maps = revisit.maps() if arguments.name is None else [revisit.map(arguments.name)]
    if arguments.json:
        show_json(maps if arguments.name is None else maps[0])
        return DONE
    if not maps:
        show("nothing is enrolled yet: `./revisit enroll IMAGE...`")
        return DONE
    heads = ("map", "ready", "pending", "failed", "places", "images", "revision", "preset", "encoder")
    rows = []
    for facts in maps:
        counts = [facts.views.get(state, 0) for state in ("ready", "pending", "failed")]
        kind = (facts.ranking.get("preset"), facts.recipe.get("encoder"))
        rows.append((facts.name, *counts, facts.places, size(facts.bytes), facts.revision, *kind))
    show(table(heads, rows))
    if arguments.name is not None:
        labels = [
            (label.index, label.label, label.dynamic, label.colour, ", ".join(label.mapped_to))
            for label in maps[0].labels
        ]
        show("\n" + table(("index", "label", "dynamic", "colour", "mapped to"), labels))
    return DONE


def run_views(arguments: argparse.Namespace) -> int:
    """List views, or show, draw, change or delete one; or delete those of a map that pass filters."""

    drawn = {kind: getattr(arguments, kind) for kind in ("image", "segmentation", "graph")}
    if arguments.id is None and (arguments.set is not None or any(drawn.values())):
        wrong_use("--set, --image, --segmentation and --graph need the id of a view")
    limit = LISTED if arguments.limit is None else arguments.limit
    if limit < 1:
        wrong_use("--limit is at least 1")
    filters, changes = filters_of(arguments), json_object("--set", arguments.set, '{"place": "hall"}')
    _check_what_is_chosen(arguments, filters)
    if arguments.delete and (changes is not None or any(drawn.values())):
        wrong_use("--delete cannot be given with --set, --image, --segmentation or --graph: do those before it")
    with service_of(arguments) as revisit:
        if arguments.delete and arguments.id is None:
            receipt = revisit.delete_views(arguments.map, **filters)
            return _deleted(arguments, receipt, f"{receipt.views} views, {receipt.images} images")
        if arguments.delete:
            receipt = revisit.delete(arguments.id)
            return _deleted(arguments, receipt, f"{arguments.id}: {receipt.images} images")
        if arguments.id is not None:
            _draw(revisit, arguments.id, drawn)
            view = revisit.view(arguments.id) if changes is None else revisit.patch(arguments.id, **changes)
            show_json(view)  # it has too many fields for a table
            return DONE
        views = list(
            revisit.views(
                arguments.map,
                state=arguments.state,
                newest_first=arguments.newest,
                words=arguments.words,
                limit=limit,
                **filters,
            )
        )
    if arguments.json:
        show_json(views)
        return DONE
    show(_table(views))
    if len(views) == limit:
        say(f"the first {limit}; --limit shows more")
    return DONE


def _check_what_is_chosen(arguments: argparse.Namespace, filters: Mapping[str, object]) -> None:
    """End with the right use where options contradict an id, or do not say which views of a map are deleted."""
    of_lists = arguments.words or arguments.state or arguments.newest or arguments.limit is not None
    if arguments.id is not None and (of_lists or arguments.map is not None or any(filters.values())):
        wrong_use("--map, filters, --words, --state, --newest and --limit are for lists; give them or the id of a view")
    if arguments.id is None and arguments.delete:
        if arguments.map is None or not any(filters.values()):
            wrong_use("--delete needs the id of a view; or --map and filters, of which all that pass are deleted")
        if of_lists:
            wrong_use("--words, --state, --newest and --limit choose no views to delete; give filters")


def _draw(revisit: "Revisit", view_id: str, files: Mapping[str, Path | None]) -> None:
    """Write images of a view to files, by their kinds."""
    draw: dict[str, Callable[[str], bytes]] = {
        "image": revisit.image,
        "segmentation": partial(revisit.segmentation, overlay=True, legend=True),
        "graph": partial(revisit.graph, legend=True),
    }
    for kind, path in files.items():
        if path is not None:
            write_file(path, draw[kind](view_id))
            say(f"{kind}: {path}")


def _table(views: "Sequence[View]") -> str:
    from app.cli.query import position_text

    heads = ("view", "map", "place", "state", "enrolled", "position", "file", "image")
    rows = [
        (
            view.id,
            view.map,
            view.place,
            view.state if view.failure is None else f"failed: {view.failure.code}",
            f"{view.enrolled_at:%Y-%m-%d %H:%M:%S}",
            position_text(view.position),
            view.filename,
            f"{view.image.width} x {view.image.height} {view.image.format}",
        )
        for view in views
    ]
    return table(heads, rows)


def run_places(arguments: argparse.Namespace) -> int:
    """List places."""

    from app.cli.query import position_text

    with service_of(arguments) as revisit:
        places = list(revisit.places(arguments.map))
    if arguments.json:
        show_json(places)
        return DONE
    if not places:
        show("no view has the name of a place; `./revisit views` lists them")
        return DONE
    rows = [
        (p.map, p.place, p.views, position_text(p.position), f"{p.last_enrolled_at:%Y-%m-%d %H:%M:%S}") for p in places
    ]
    show(table(("map", "place", "views", "position", "last enrolled"), rows))
    return DONE


def _deleted(arguments: argparse.Namespace, receipt: "Deleted", what: str) -> int:
    """Tell what was deleted, and what the deletion did not reach."""
    named = [one.id for one in receipt.snapshots]
    if receipt.snapshots_of_others:
        named.append(f"{receipt.snapshots_of_others} of other maps")
    if arguments.json:
        show_json(receipt)
    else:
        left = f"; snapshots that may still have some of it: {', '.join(named)}" if named else ""
        show(f"deleted {what}{left}")
    return DONE
