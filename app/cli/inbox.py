"""``revisit inbox``: queries that a map kept, to be named as places, taken as views, or dismissed."""

import argparse
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from app.cli.options import Verbs, add_service_options, integer, json_object, service_of
from app.cli.output import DONE, Failure, say, show, show_json, table, write_file, wrong_use

if TYPE_CHECKING:
    from pydantic import BaseModel
    from revisit_client import Revisit
    from revisit_client.wire import Proposals, UnknownPlaces

MOST = 500
"""Places of each kind that are looked at."""


def add(verbs: Verbs) -> None:
    """Declare the command."""
    parser = verbs.add_parser(
        "inbox",
        help="queries that matched nothing, and places in another light: name, take, dismiss",
        description="Queries that a map kept: those that matched nothing, by spot, to be named as places; and those "
        "that matched a place although they look unlike its views, to be taken as further views of it.",
    )
    parser.add_argument("map", nargs="?", default="default", help="which map (default: default)")
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--keep", type=integer, metavar="N", help="keep at most N queries of each kind from now on; 0: none"
    )
    what.add_argument("--name", nargs=2, metavar=("ID", "PLACE"), help="enrol the images of a spot as this place")
    what.add_argument("--accept", metavar="ID", help="take images of a proposal as views; `confirmed`: of all that are")
    what.add_argument("--dismiss", metavar="ID", help="delete the queries of a spot or of a proposal, and their images")
    parser.add_argument(
        "--position",
        metavar="JSON",
        help='with --name: where the place is, {"x": 1.5, "y": 2.0} or {"lat": ..., "lon": ...}',
    )
    parser.add_argument(
        "--views", type=integer, default=3, help="with --accept: images of a place at most (default: 3)"
    )
    parser.add_argument("--unconfirmed", action="store_true", help="with --accept: what no other image confirms, too")
    parser.add_argument("--images", type=Path, metavar="DIR", help="save an image of each spot and proposal there")
    add_service_options(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Do what was asked, or list what is kept."""

    if arguments.accept is None and arguments.unconfirmed:
        wrong_use("--unconfirmed goes with --accept")
    position = json_object("--position", arguments.position, '{"x": 1.5, "y": 2.0}')
    if position is not None and arguments.name is None:
        wrong_use("--position goes with --name")
    with service_of(arguments) as revisit:
        if arguments.keep is not None:
            facts = revisit.change_map(arguments.map, keep_queries=arguments.keep, keep_matches=arguments.keep)
            return _done(arguments, facts, f"at most {arguments.keep} queries of each kind are kept")
        if arguments.name is not None:
            spot, place = arguments.name
            named = revisit.name_unknown(arguments.map, spot, place, position=position)
            return _done(arguments, named, f"{len(named.views)} images of {place} enrolled")
        unknown = revisit.unknown(arguments.map, limit=MOST)
        proposals = revisit.proposals(arguments.map, limit=MOST)
        if arguments.accept is not None:
            return _accept(revisit, arguments, proposals)
        if arguments.dismiss is not None:
            return _dismiss(revisit, arguments, unknown, proposals)
        if arguments.images is not None:
            _save(revisit, arguments.map, arguments.images, unknown, proposals)
    if arguments.json:
        show_json({"unknown": unknown, "proposals": proposals})
    else:
        _list(unknown, proposals)
    return DONE


def _done(arguments: argparse.Namespace, answer: "BaseModel", text: str) -> int:
    """Tell what became of a call."""
    if arguments.json:
        show_json(answer)
    else:
        say(f"{arguments.map}: {text}")
    return DONE


def _list(unknown: "UnknownPlaces", proposals: "Proposals") -> None:
    if unknown.places:
        rows = [(one.id, one.count, _minute(one.first_at), _minute(one.last_at)) for one in unknown.places]
        show(table(("spot that is not known", "queries", "first", "last (UTC)"), rows) + "\n")
    if proposals.proposals:
        heads = ("place in another light", "of", "queries", "confirmed", "lowest score", "last (UTC)")
        show(
            table(
                heads,
                [
                    (
                        one.id,
                        one.place or f"view {one.view}",
                        one.count,
                        one.confirmed,
                        one.lowest_score,
                        _minute(one.last_at),
                    )
                    for one in proposals.proposals
                ],
            )
        )
    for kept, most, kind in (
        (unknown.kept, unknown.keep_queries, "matched nothing"),
        (proposals.kept, proposals.keep_matches, "matched in another light"),
    ):
        off = "" if most else "; none are kept: `--keep 500` changes that"
        say(f"{unknown.map}: {kept} of at most {most} queries that {kind}{off}")


def _minute(at: datetime) -> str:
    return f"{at.astimezone(UTC):%Y-%m-%d %H:%M}"


def _accept(revisit: "Revisit", arguments: argparse.Namespace, proposals: "Proposals") -> int:
    from revisit_client import RevisitProblem

    chosen = [one for one in proposals.proposals if arguments.accept in ("confirmed", one.id)]
    if arguments.accept == "confirmed":
        chosen = [one for one in chosen if one.confirmed]
    elif not chosen:
        raise Failure(f"there is no proposal {arguments.accept}; `revisit inbox {arguments.map}` lists them")
    done = []
    for one in chosen:
        try:
            accepted = revisit.accept_proposal(
                arguments.map, one.id, views=arguments.views, unconfirmed=arguments.unconfirmed
            )
        except RevisitProblem as problem:  # a place that has as many as are taken does not keep the others from theirs
            if problem.code != "conflict" or arguments.accept != "confirmed":
                raise
            say(f"{one.place or f'view {one.view}'}: {problem.detail}")
            continue
        done.append(accepted)
        if not arguments.json:
            show(f"{one.place or f'view {one.view}'}: {', '.join(view.id for view in accepted.views)}")
    if arguments.json:
        show_json(done)
        return DONE
    taken = sum(len(accepted.views) for accepted in done)
    say(f"{arguments.map}: {taken} views added to {len(done)} places; they are described in the background")
    return DONE


def _dismiss(
    revisit: "Revisit", arguments: argparse.Namespace, unknown: "UnknownPlaces", proposals: "Proposals"
) -> int:
    if any(one.id == arguments.dismiss for one in unknown.places):
        gone = revisit.dismiss_unknown(arguments.map, arguments.dismiss)
    elif any(one.id == arguments.dismiss for one in proposals.proposals):
        gone = revisit.dismiss_proposal(arguments.map, arguments.dismiss)
    else:
        raise Failure(
            f"nothing here is called {arguments.dismiss}; `revisit inbox {arguments.map}` lists what there is"
        )
    return _done(arguments, gone, f"{gone.queries} queries deleted, with their images")


def _save(revisit: "Revisit", name: str, folder: Path, unknown: "UnknownPlaces", proposals: "Proposals") -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for spot in unknown.places:
        write_file(folder / f"{spot.id}.jpg", revisit.unknown_image(name, spot.id))
    for one in proposals.proposals:
        write_file(folder / f"{one.id}.jpg", revisit.proposal_image(name, one.id))
    say(f"{len(unknown.places) + len(proposals.proposals)} images in {folder}")
