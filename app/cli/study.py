"""``revisit evaluate | benchmark``: recognition and speed; `lab` parses their arguments."""

import argparse
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from app.cli.options import Verbs

if TYPE_CHECKING:
    import httpx

    from worker.runtime import Runtime

PASSED_ON = {
    "evaluate": "measure recognition on images with ground truth",
    "benchmark": "measure the stages of enrolling and querying",
}


def add(verbs: Verbs) -> None:
    """Declare the commands; everything after them is passed on, `--help` too."""
    for name, text in PASSED_ON.items():
        parser = verbs.add_parser(name, help=text, add_help=False)
        # This parser knows no arguments: all of them arrive as `rest`.
        parser.set_defaults(run={"evaluate": run_evaluate, "benchmark": run_benchmark}[name], rest=[])


def run_evaluate(arguments: argparse.Namespace) -> int:
    """Run `lab.evaluate`, which may also evaluate a service behind a URL."""
    from lab import evaluate
    from lab.evaluation.remote import connect

    return evaluate.main(arguments.rest, connect)


def run_benchmark(arguments: argparse.Namespace) -> int:
    """Run `lab.benchmarks`, with a way to call a runtime over HTTP."""
    from lab.benchmarks import __main__ as benchmarks

    return benchmarks.main(arguments.rest, over_http)


def over_http(runtime: "Runtime") -> "AbstractContextManager[httpx.Client]":
    """A client of a runtime's HTTP service in this process; the runtime runs while it is open."""
    from fastapi.testclient import TestClient

    from app.http.application import create_app

    return TestClient(create_app(runtime))
