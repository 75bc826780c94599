"""Options that several commands have."""

import argparse
import json
import math
from typing import TYPE_CHECKING, Any, TypeAlias

from app.cli.output import wrong_use

if TYPE_CHECKING:
    from revisit_client import Revisit

Verbs: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
"""The collection that commands are added to; argparse has no public name for it."""


def add_service_options(
    parser: argparse.ArgumentParser,
    url: str = "address of the service (default: REVISIT_URL, or http://127.0.0.1:8000)",
) -> None:
    """Add the options of all commands that call a running service; `url` is the help of that option."""
    parser.add_argument("--url", help=url)
    parser.add_argument("--key", help="key of the service; REVISIT_KEY is better, since others can list arguments")
    parser.add_argument("--json", action="store_true", help="answer as JSON, for machines")


def service_of(arguments: argparse.Namespace) -> "Revisit":
    """The client of the service that these options name."""
    from revisit_client import Revisit

    return Revisit(arguments.url, key=arguments.key)


def number(text: str) -> float:
    """The number of an option, finite; raises ArgumentTypeError, also for 12_5, which Python alone reads as 125."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if "_" in text or not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is no number")
    return value


def integer(text: str) -> int:
    """The whole number of an option; raises ArgumentTypeError, also for 1_0."""
    try:
        if "_" not in text:
            return int(text)
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"{text!r} is no whole number")


def json_object(option: str, text: str | None, example: str) -> dict[str, Any] | None:
    """Parse the JSON object of an option, None when it is not given; raises Failure (exit code 2)."""
    if text is None:
        return None
    try:
        value = json.loads(text)
    except ValueError as error:
        wrong_use(f"{option} is not JSON: {error}")
    if not isinstance(value, dict):
        wrong_use(f"{option} takes a JSON object such as {example}")
    return value
