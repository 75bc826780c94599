"""How far a run is, on standard error."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress as Bars, TaskID, TextColumn, TimeRemainingColumn

from lab.evaluation.querying import Progress


@contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """A bar for each thing that is counted while the block runs; without a terminal, a line for each tenth."""
    columns = (MofNCompleteColumn(), TextColumn("{task.description}", markup=False), BarColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    tasks: dict[str, TaskID] = {}
    # Standard output is left as it is: a report may be piped somewhere.
    with Bars(*columns, console=console, redirect_stdout=False, disable=not console.is_terminal) as bars:

        def tell(what: str, done: int, total: int) -> None:
            if not console.is_terminal:
                if 10 * done // total > 10 * (done - 1) // total:
                    print(f"{title}: {what} {done}/{total}", file=sys.stderr, flush=True)
                return
            if what not in tasks:
                tasks[what] = bars.add_task(f"{title}: {what}", total=total)
            elif done == 1:  # the next method begins
                bars.reset(tasks[what])
            bars.update(tasks[what], completed=done)

        yield tell
