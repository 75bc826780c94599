"""``python -m app.cli``: the command line; the launcher ``./revisit`` runs it."""

import argparse
import difflib
import errno
import importlib
import os
import sys
from collections.abc import Sequence

from app.cli.filters import points_joined
from app.cli.output import FAILED, READER_GONE, WRONG_USE, Failure, error_text, say
from app.version import VERSION

GROUPS = (
    "serve",
    "encode",
    "demo",
    "enroll",
    "recordings",
    "query",
    "changes",
    "loops",
    "browse",
    "jobs",
    "recipes",
    "shadow",
    "calibrate",
    "health",
    "privacy",
    "inbox",
    "running",
    "keys",
    "migrate",
    "snapshots",
    "doctor",
    "study",
    "weights",
)
"""Modules with commands. Slow imports happen when a command runs, so that `--help` answers at once."""

EPILOG = """\
Commands that call a service take its address from REVISIT_URL. Settings are environment variables REVISIT_*:
docs/settings.md lists them. Exit codes: 0 done, 1 failed, 2 wrong use.
"""


def parser() -> argparse.ArgumentParser:
    """All commands with their arguments."""
    whole = argparse.ArgumentParser(
        prog="revisit",
        description="Have I been here before, and where is here? Enrol photos of places; query with photos.",
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    whole.add_argument("--version", action="version", version=f"revisit {VERSION}")
    verbs = whole.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name in GROUPS:
        importlib.import_module(f"app.cli.{name}").add(verbs)
    test = verbs.add_parser(
        "test",
        help="run every check of a checkout",
        description="Run every check of a checkout. Arguments are pytest's, which then runs by itself: "
        "`./revisit test tests/method -k hough`.",
    )
    test.set_defaults(run=_test)
    _describe(whole)
    return whole


def _describe(parser: argparse.ArgumentParser) -> None:
    """Let the help of each command without a description begin with its line in the list of commands."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for line in action._get_subactions():
                command = action.choices[line.dest]
                if command.description is None and line.help:
                    command.description = f"{line.help[0].upper()}{line.help[1:]}."
                _describe(command)


def _test(arguments: argparse.Namespace) -> int:
    # In a checkout the launcher handles `test` itself; a container has neither launcher nor tests.
    raise Failure("tests run from a checkout: `./revisit test`", WRONG_USE)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit code."""
    _open_closed_streams()
    try:
        whole = parser()
        given = points_joined(sys.argv[1:] if argv is None else argv)
        if (near := _meant(whole, given)) is not None:
            whole.error(f"there is no command {given[0]!r}; did you mean {near!r}? `revisit --help` lists all")
        arguments, rest = whole.parse_known_args(given)
        if rest and not hasattr(arguments, "rest"):
            whole.error(f"unrecognized arguments: {' '.join(rest)}")
        arguments.rest = rest
        if hasattr(arguments, "url") and getattr(arguments, "service", True):  # `version` may call none
            _check_settings()
        return int(arguments.run(arguments))
    except Failure as failure:
        say(f"revisit: {failure}")
        return failure.code
    except KeyboardInterrupt:
        say("revisit: interrupted")
        return 130
    except BrokenPipeError:
        # The reader of the output (`| head`) has gone: whether all went well was part of what it did not read.
        sys.stderr.close()
        return READER_GONE
    except Exception as error:
        if (text := _foreseen(error)) is None:
            raise
        say(f"revisit: {text}")
        return FAILED


def _open_closed_streams() -> None:
    """Let standard streams that were closed for this process lead nowhere: else the next files that it opens get their
    numbers, and what is said on stderr goes to stdout."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            stream = open(os.devnull, mode, encoding="utf-8")  # noqa: SIM115 (it stays open as long as the process runs)
            os.set_inheritable(stream.fileno(), True)
            setattr(sys, name, stream)


def _check_settings() -> None:
    """Refuse a mistyped REVISIT_URL or REVISIT_KEY: without it the command would call another service."""
    from schemas.settings import refuse_unknown

    refuse_unknown(os.environ)


def _meant(whole: argparse.ArgumentParser, given: Sequence[str]) -> str | None:
    """The command that is nearest to one that does not exist, `enroll` to `enrol`; None where none is."""
    verbs = [name for action in whole._actions if action.nargs == argparse.PARSER for name in action.choices or ()]
    if not given or given[0].startswith("-") or given[0] in verbs:
        return None
    return next(iter(difflib.get_close_matches(given[0], verbs, n=1)), None)


def _foreseen(error: Exception) -> str | None:
    """The message for an expected error; None for one that needs a traceback."""
    if isinstance(error, ModuleNotFoundError) and error.name is not None:
        if error.name.partition(".")[0] in ("lab", "scenes", "training"):
            return "this installation holds the service alone; run this command in a checkout of the repository"
        return f"the package {error.name} is not installed; `./revisit set-up` installs what is needed"
    from revisit_client import ClientError

    from schemas.errors import RevisitError
    from schemas.threads import NO_MORE_THREADS, is_shortage

    if is_shortage(error):
        return NO_MORE_THREADS
    if isinstance(error, ClientError | RevisitError | TimeoutError):
        return error_text(error)
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
        return f"the output cannot be written: {error.strerror}"
    return None


if __name__ == "__main__":
    sys.exit(main())
