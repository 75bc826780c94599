"""How the command line talks: tables, progress, failures with a next step, exit codes."""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from typing import Any, NoReturn, TypeAlias

DONE, FAILED, WRONG_USE = 0, 1, 2
"""Exit codes: as asked, tried and failed, asked wrongly."""


class Failure(Exception):
    """A command did not do what it was asked; the text says why and what to do next."""

    def __init__(self, text: str, code: int = FAILED) -> None:
        super().__init__(text)
        self.code = code


def wrong_use(text: str) -> NoReturn:
    """Refuse arguments that cannot be used."""
    raise Failure(text, WRONG_USE)


def say(text: str) -> None:
    """A line for people, beside the output: on stderr, so that a pipe gets results only."""
    print(text, file=sys.stderr, flush=True)


def show(text: str) -> None:
    """A line of output."""
    print(text, flush=True)


def show_json(value: Any) -> None:
    """Output for machines."""
    print(json.dumps(value, indent=2, ensure_ascii=False, default=str), flush=True)


def table(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Columns as wide as they need to be; numbers to the right."""
    texts = [[_cell(value) for value in row] for row in rows]
    widths = [max([len(head), *(len(row[i]) for row in texts)]) for i, head in enumerate(heads)]
    numeric = [_is_numeric([row[i] for row in rows]) for i in range(len(heads))]

    def line(cells: Sequence[str]) -> str:
        padded = [c.rjust(w) if n else c.ljust(w) for c, w, n in zip(cells, widths, numeric, strict=True)]
        return "  ".join(padded).rstrip()

    return "\n".join([line(heads), line(["-" * width for width in widths]), *map(line, texts)])


def _is_numeric(column: Sequence[object]) -> bool:
    told = [value for value in column if value is not None]
    return bool(told) and all(isinstance(value, int | float) and not isinstance(value, bool) for value in told)


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def size(count: float) -> str:
    """Bytes for people: 1.2 MB."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} TB"


@contextmanager
def progress_bar(total: int, what: str, *, quiet: bool = False) -> Iterator[Callable[[str], None]]:
    """How far a long command is, on stderr: a bar on a terminal, elsewhere a line for each tenth.

    Parameters
    ----------
    total : int
        How many there are to do.
    what : str
        Of what.
    quiet : bool
        Show nothing.

    Yields
    ------
    function of str
        To be called when one more is done, with what it was; from any thread, one at a time.
    """
    # Before set-up the command line has to be able to tell its help.
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (MofNCompleteColumn(), TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    note = TextColumn("{task.fields[note]}", markup=False)
    console = Console(stderr=True)
    lines = not quiet and not console.is_terminal
    # Standard output is left as it is: results may be piped somewhere.
    with Progress(*columns, note, console=console, redirect_stdout=False, disable=quiet or lines) as bars:
        task, numbers = bars.add_task(what, total=total, note=""), count(1)

        def step(note: str) -> None:
            done = next(numbers)
            bars.update(task, completed=done, note=note)
            if lines and 10 * done // total > 10 * (done - 1) // total:
                say(f"{done}/{total} {what}")

        yield step


Verbs: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
"""What commands are added to; argparse has no public name for it."""


def speaks(parser: argparse.ArgumentParser) -> None:
    """Arguments of all commands that ask a running service."""
    parser.add_argument("--url", help="address of the service (default: REVISIT_URL, or http://127.0.0.1:8000)")
    parser.add_argument("--json", action="store_true", help="answer as JSON, for machines")
