"""How the command line talks: tables, progress, failures with a next step, exit codes."""

import argparse
import json
import sys
import time
from collections.abc import Sequence
from typing import Any, NoReturn, TextIO, TypeAlias

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


class Progress:
    """How far a long command is, on stderr: a bar on a terminal, elsewhere a line now and then."""

    WIDTH = 28

    def __init__(self, total: int, what: str, stream: TextIO | None = None) -> None:
        self.total, self.what = total, what
        self._stream = stream or sys.stderr
        self._bar = self._stream.isatty()
        self._done, self._begun, self._shown = 0, time.monotonic(), -1.0

    def step(self, note: str = "") -> None:
        """One more is done."""
        self._done += 1
        now = time.monotonic()
        pause = 0.1 if self._bar else 5.0
        if now - self._shown < pause and self._done < self.total:
            return
        self._shown = now
        rate = self._done / max(now - self._begun, 1e-6)
        left = (self.total - self._done) / rate
        text = f"{self._done}/{self.total} {self.what}, {rate:.1f}/s"
        if self._done < self.total:
            text += f", {left:.0f} s left"
        if self._bar:
            filled = self.WIDTH * self._done // max(self.total, 1)
            bar = "#" * filled + "." * (self.WIDTH - filled)
            self._stream.write(f"\r[{bar}] {text} {note}"[:110].ljust(110))
        else:
            self._stream.write(f"{text}\n")
        self._stream.flush()

    def end(self) -> None:
        """Leave the bar's line."""
        if self._bar and self._done:
            self._stream.write("\n")
            self._stream.flush()


Verbs: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
"""What commands are added to; argparse has no public name for it."""


def speaks(parser: argparse.ArgumentParser) -> None:
    """Arguments of all commands that ask a running service."""
    parser.add_argument("--url", help="address of the service (default: REVISIT_URL, or http://127.0.0.1:8000)")
    parser.add_argument("--json", action="store_true", help="answer as JSON, for machines")
