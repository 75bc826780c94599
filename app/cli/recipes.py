"""``revisit vocabulary train | recipe``: train a map's vocabulary; show or change its recipe and ranking."""

import argparse
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from app.cli.options import Verbs, add_service_options, integer, json_object, service_of
from app.cli.output import DONE, job_progress, say, show, show_json, table, wrong_use
from app.cli.shadow import show_shadow

if TYPE_CHECKING:
    from revisit_client import Revisit
    from revisit_client.wire import DynamicPreview, Job

EXAMPLE = '{"candidates": 50}'

DEFAULT_QUERIES = 100
"""Queries of `--shadow` without a number."""


def add(verbs: Verbs) -> None:
    """Declare the commands."""
    vocabulary = verbs.add_parser("vocabulary", help="train a map's own vocabulary")
    trains = vocabulary.add_subparsers(title="commands", metavar="COMMAND", required=True)
    train = trains.add_parser("train", help="train on the map's own views, then describe them by it")
    train.add_argument("--map", default="default", help="which map (default: default)")
    _waits(train)
    train.set_defaults(run=run_vocabulary)

    recipe = verbs.add_parser(
        "recipe",
        help="show a map's recipe, or change it",
        description="Show a map's recipe and ranking. --ranking alone takes effect at the next query; any other "
        "option describes the views anew, and queries use the old recipe until that is done.",
    )
    recipe.add_argument("--map", default="default", help="which map (default: default)")
    recipe.add_argument(
        "--preset",
        help="named set of parameters, such as default or paper; the map's own: as this version of the service has it",
    )
    recipe.add_argument("--labels", metavar="LABEL,...", help="labels that cells are assigned to")
    recipe.add_argument("--dynamic", metavar="LABEL,...", help="labels of things that move; empty: none")
    recipe.add_argument("--parameters", metavar="JSON", help="description parameters that differ from the preset's")
    recipe.add_argument("--ranking", metavar="JSON", help="ranking parameters that differ from the preset's")
    recipe.add_argument(
        "--shadow",
        type=integer,
        nargs="?",
        const=DEFAULT_QUERIES,
        metavar="N",
        help="do not change over: answer the last N kept queries by both recipes first (100); see `revisit shadow`",
    )
    recipe.add_argument("--preview", action="store_true", help="show what --dynamic would leave out, change nothing")
    _waits(recipe)
    recipe.set_defaults(run=run_recipe)


def _waits(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--no-wait", action="store_true", help="return once the job has started")
    add_service_options(parser)


def run_vocabulary(arguments: argparse.Namespace) -> int:
    """Train a vocabulary."""

    with service_of(arguments) as revisit:
        return _finished(revisit, revisit.train_vocabulary(arguments.map), arguments)


def run_recipe(arguments: argparse.Namespace) -> int:
    """Show a map's recipe and ranking, change the ranking, or switch the recipe."""

    parameters = json_object("--parameters", arguments.parameters, EXAMPLE)
    ranking = json_object("--ranking", arguments.ranking, EXAMPLE)
    labels, dynamic = _labels(arguments.labels), _labels(arguments.dynamic)
    describes = not (arguments.preset is None and labels is None and dynamic is None and parameters is None)
    if arguments.preview and dynamic is None:
        wrong_use("--preview needs --dynamic")
    if arguments.shadow is not None and (arguments.preview or not describes):
        wrong_use("--shadow goes with what is to change: --preset, --labels, --dynamic or --parameters")
    with service_of(arguments) as revisit:
        if arguments.preview:
            return _previewed(revisit.preview_dynamic(arguments.map, dynamic or ()), arguments)
        if describes:
            job = revisit.switch_recipe(
                arguments.map,
                labels=labels,
                dynamic=dynamic,
                preset=arguments.preset,
                parameters=parameters,
                ranking=ranking,
                shadow=arguments.shadow,
            )
            return _finished(revisit, job, arguments)
        facts = revisit.map(arguments.map) if ranking is None else revisit.change_ranking(arguments.map, **ranking)
    if arguments.json:
        show_json(facts.model_dump(mode="json", include={"recipe", "ranking", "preset_differences"}))
    else:
        show(f"map {facts.name}, preset {facts.ranking.get('preset')}")
        if facts.preset_differences:
            rows = [(one.parameter, _text(one.value), _text(one.preset)) for one in facts.preset_differences]
            show("\ndiffers from its preset\n" + table(("parameter", "here", "preset"), rows))
        for title, fields in (("described by", facts.recipe), ("ranked by", facts.ranking)):
            show(f"\n{title}\n" + table(("parameter", "value"), list(_lines(fields))))
    return DONE


def _previewed(preview: "DynamicPreview", arguments: argparse.Namespace) -> int:
    if arguments.json:
        show_json(preview)
        return DONE
    left_out = f"at most {preview.after:.1%} of their area would be left out, {preview.before:.1%} are now"
    show(f"{preview.views} views; {left_out}")
    if preview.nothing_left:
        several = "s" * (preview.nothing_left != 1)
        show(f"{preview.nothing_left} view{several} would have nothing left, and could not be described")
    if preview.labels:
        show(table(("label", "share", "views"), [(one.label, f"{one.share:.1%}", one.views) for one in preview.labels]))
    if preview.most:
        rows = [(one.view.filename or one.view.id, one.view.place, f"{one.share:.1%}") for one in preview.most]
        show("\nthose that would lose most\n" + table(("view", "place", "share"), rows))
    return DONE


def _lines(fields: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Fields of an object as (name with its path, value as text)."""
    for name, value in fields.items():
        if isinstance(value, Mapping):
            yield from _lines(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", _text(value)


def _text(value: object) -> str:
    """A value of a recipe, for a table."""
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else "-" if value is None else str(value)


def _labels(text: str | None) -> list[str] | None:
    return None if text is None else [label.strip() for label in text.split(",") if label.strip()]


def _finished(revisit: "Revisit", job: "Job", arguments: argparse.Namespace) -> int:
    if not arguments.no_wait:
        say(f"job {job.id} is running; interrupting this command does not stop it")
        with job_progress(f"images, {job.kind} of map {job.map}", quiet=arguments.json) as follow:
            job = revisit.wait_for_job(job.id, timeout=24 * 3600, follow=follow)
    if arguments.json:
        show_json(job)
    else:
        show(f"{job.kind} of map {job.map}: {job.state}")
        if job.kind == "shadow" and job.state == "done":
            show_shadow(revisit.shadow(job.map))
    return DONE
