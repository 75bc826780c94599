"""Output of the command line: tables, progress, failures with a next step, exit codes."""

import codecs
import json
import os
import sys
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

if TYPE_CHECKING:
    from revisit_client.wire import Job

DONE, FAILED, WRONG_USE, READER_GONE = 0, 1, 2, 141
"""Exit codes: done, failed, wrong arguments, and that of a program which SIGPIPE ended, as shells give it."""


class Failure(Exception):
    """A command failed; the text says why and what to do next, `code` is the exit code."""

    def __init__(self, text: str, code: int = FAILED) -> None:
        super().__init__(text)
        self.code = code


def wrong_use(text: str) -> NoReturn:
    """Raise Failure for arguments that cannot be used."""
    raise Failure(text, WRONG_USE)


def error_text(error: BaseException) -> str:
    """What an error of the client says, and where a command takes the key from that is missing."""
    hint = "\nThe command line takes the key from REVISIT_KEY, or from --key"
    return f"{error}{hint if getattr(error, 'code', None) == 'unauthorized' else ''}"


def say(text: str) -> None:
    """Print a message on stderr, so that a pipe gets results only."""
    print(_printable(text, sys.stderr), file=sys.stderr, flush=True)


def show(text: str) -> None:
    """Print a result on stdout, in one write: lines of a log that share the terminal do not come between."""
    print(f"{_printable(text, sys.stdout)}\n", end="", flush=True)


def show_json(value: Any) -> None:
    """Print a result on stdout as JSON; it may be a model, or have some in it."""
    escaped = _encoding(sys.stdout) != "utf-8"  # a letter that the terminal does not have is \u00e9 in JSON alone
    print(_printable(json.dumps(value, indent=2, ensure_ascii=escaped, default=_plain), sys.stdout), flush=True)


def write_file(path: Path, content: bytes) -> None:
    """Write a file: all of it, or what was there before stays.

    Only what cannot be replaced is written in place: a device or a pipe, such as /dev/stdout, and a file in a folder
    that takes no new ones.

    Raises
    ------
    OSError
        With the path as its file name.
    """
    target = path.resolve()  # a symbolic link stays one
    exists = path.exists()
    replaceable = path.is_file() and os.access(target, os.W_OK) and os.access(target.parent, os.W_OK)
    unfinished = target.with_name(f".{uuid.uuid4().hex}.unfinished")
    try:
        if (exists and not replaceable) or str(path.absolute().parent) in ("/dev", "/dev/fd"):
            path.write_bytes(content)
            return
        try:
            with unfinished.open("xb") as file:
                file.write(content)
            if exists:
                unfinished.chmod(target.stat().st_mode & 0o777)
            unfinished.replace(target)
        finally:
            unfinished.unlink(missing_ok=True)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


def _plain(value: object) -> Any:
    """A model as an object, anything else that JSON has no form for as text."""
    return value.model_dump(mode="json") if hasattr(value, "model_dump") else str(value)


def _printable(text: str, stream: TextIO) -> str:
    r"""What an output cannot carry, escaped: letters that a locale such as ISO-8859-1 lacks, and bytes of a file's name
    that are no UTF-8, which Python keeps as lone surrogates, as \udcff: in JSON too."""
    encoding = _encoding(stream)
    return text.encode(encoding, "backslashreplace").decode(encoding)


def _encoding(stream: TextIO) -> str:
    return codecs.lookup(getattr(stream, "encoding", None) or "utf-8").name


def table(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A text table; columns of numbers are aligned to the right, None is shown as -."""
    texts = [[_cell(value) for value in row] for row in rows]
    widths = [max([len(head), *(len(row[i]) for row in texts)]) for i, head in enumerate(heads)]
    numeric = [_is_numeric([row[i] for row in rows]) for i in range(len(heads))]

    def line(cells: Sequence[str]) -> str:
        padded = [c.rjust(w) if n else c.ljust(w) for c, w, n in zip(cells, widths, numeric, strict=True)]
        return "  ".join(padded).rstrip()

    return "\n".join([line(heads), line(["-" * width for width in widths]), *map(line, texts)])


def _is_numeric(column: Sequence[object]) -> bool:
    given = [value for value in column if value is not None]
    return bool(given) and all(isinstance(value, int | float) and not isinstance(value, bool) for value in given)


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def size(count: float) -> str:
    """A number of bytes with a decimal unit: 1.2 MB."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} TB"


@contextmanager
def job_progress(what: str, *, quiet: bool = False) -> Iterator[Callable[["Job"], None]]:
    """Show the progress of a job on stderr, as `progress_bar`: yields a function to call with each state of the job.

    A job that comes to know more to do, or begins another part of its work, begins a new count.
    """
    with ExitStack() as bars:
        step: Callable[[str], None] | None = None
        total = shown = 0

        def follow(job: "Job") -> None:
            nonlocal step, total, shown
            if job.progress is None or job.progress.total == 0:
                return
            if step is None or job.progress.total != total or job.progress.done < shown:
                bars.pop_all().close()
                total, shown = job.progress.total, 0
                step = bars.enter_context(progress_bar(total, what, quiet=quiet))
            while shown < job.progress.done:
                step("")
                shown += 1

        yield follow


@contextmanager
def progress_bar(total: int, what: str, *, quiet: bool = False) -> Iterator[Callable[[str], None]]:
    """Show progress on stderr: a bar on a terminal, elsewhere a line for each tenth.

    Parameters
    ----------
    total : int
        Number of items.
    what : str
        Name of the items, such as "images enrolled".
    quiet : bool
        Show nothing.

    Yields
    ------
    function of str
        To call when an item is done, with its name; from any thread, one call at a time.
    """
    # Imported late: `--help` has to work before rich is installed.
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (MofNCompleteColumn(), TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    note = TextColumn("{task.fields[note]}", markup=False)
    console = Console(stderr=True)
    lines = not quiet and not console.is_terminal
    # Standard output is not redirected: results may be piped.
    with Progress(*columns, note, console=console, redirect_stdout=False, disable=quiet or lines) as bars:
        task, numbers = bars.add_task(what, total=total, note=""), count(1)

        def step(note: str) -> None:
            done = next(numbers)
            bars.update(task, completed=done, note=note)
            if lines and 10 * done // total > 10 * (done - 1) // total:
                say(f"{done}/{total} {what}")

        yield step
