"""Options that several commands have."""

import argparse
import json
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
