"""``revisit vocabulary train | recipe``: describe a map's views by another recipe."""

import argparse
import json
from typing import TYPE_CHECKING

from app.cli.console import DONE, Verbs, say, show, show_json, speaks, wrong_use

if TYPE_CHECKING:
    from revisit_client import Revisit
    from revisit_client.wire import Job


def add(verbs: Verbs) -> None:
    """Declare the commands."""
    vocabulary = verbs.add_parser("vocabulary", help="train a map's own vocabulary")
    trains = vocabulary.add_subparsers(title="commands", metavar="COMMAND", required=True)
    train = trains.add_parser("train", help="train on the map's own views, then describe them by it")
    train.add_argument("--map", default="default")
    _waits(train)
    train.set_defaults(run=run_vocabulary)

    recipe = verbs.add_parser(
        "recipe",
        help="show a map's recipe, or change it",
        description="Show a map's recipe. With any of the options its views are described anew; until that is done, "
        "queries are answered by the old recipe.",
    )
    recipe.add_argument("--map", default="default")
    recipe.add_argument("--preset", help="named set of parameters, such as default or paper")
    recipe.add_argument("--labels", metavar="WORD,WORD,...", help="words that pixels are labelled with")
    recipe.add_argument("--dynamic", metavar="WORD,WORD,...", help="words of things that move; empty: none")
    recipe.add_argument("--parameters", metavar="JSON", help="parameters that differ from the preset's")
    _waits(recipe)
    recipe.set_defaults(run=run_recipe)


def _waits(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--no-wait", action="store_true", help="return once it has begun")
    speaks(parser)


def run_vocabulary(arguments: argparse.Namespace) -> int:
    """Train."""
    from revisit_client import Revisit

    with Revisit(arguments.url) as revisit:
        return _finished(revisit, revisit.train_vocabulary(arguments.map), arguments)


def run_recipe(arguments: argparse.Namespace) -> int:
    """Show the recipe, or switch to another."""
    from revisit_client import Revisit

    parameters = None
    if arguments.parameters is not None:
        try:
            parameters = json.loads(arguments.parameters)
        except ValueError as error:
            wrong_use(f"--parameters is not JSON: {error}")
        if not isinstance(parameters, dict):
            wrong_use('--parameters takes a JSON object such as {"local_features": 500}')
    labels, dynamic = _words(arguments.labels), _words(arguments.dynamic)
    with Revisit(arguments.url) as revisit:
        if arguments.preset is None and labels is None and dynamic is None and parameters is None:
            facts = revisit.map(arguments.map)
            show_json({"recipe": facts.recipe, "ranking": facts.ranking})
            return DONE
        job = revisit.switch_recipe(
            arguments.map, labels=labels, dynamic=dynamic, preset=arguments.preset, parameters=parameters
        )
        return _finished(revisit, job, arguments)


def _words(text: str | None) -> list[str] | None:
    return None if text is None else [word.strip() for word in text.split(",") if word.strip()]


def _finished(revisit: "Revisit", job: "Job", arguments: argparse.Namespace) -> int:
    if not arguments.no_wait:
        say(f"job {job.id} is at work; interrupting this does not stop it")
        job = revisit.wait_for_job(job.id, timeout=24 * 3600)
    if arguments.json:
        show_json(job.model_dump(mode="json"))
    else:
        show(f"{job.kind} of map {job.map}: {job.state}")
    return DONE
