"""``revisit evaluate | benchmark``: how well it recognises, and how fast. Their own arguments are their modules'."""

import argparse
import importlib

from app.cli.console import Verbs


def add(verbs: Verbs) -> None:
    """Declare the commands; everything after them is passed on, `--help` too."""
    for name, text in (
        ("evaluate", "measure recognition on pictures with ground truth"),
        ("benchmark", "measure the stages of enrolling and asking"),
    ):
        parser = verbs.add_parser(name, help=text, add_help=False)
        parser.add_argument("rest", nargs=argparse.REMAINDER)
        parser.set_defaults(run=run, module={"evaluate": "worker.evaluate", "benchmark": "benchmarks.__main__"}[name])


def run(arguments: argparse.Namespace) -> int:
    """Hand over."""
    module = importlib.import_module(arguments.module)
    if arguments.module == "worker.evaluate":
        from app.measured import contender

        return int(module.main(arguments.rest, contender))
    return int(module.main(arguments.rest))
