"""How far a run is, on standard error."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

from lab.evaluation.querying import Progress


@contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """A bar for each thing that is counted while the block runs; without a terminal, only where they ended."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    tasks: dict[str, TaskID] = {}
    # Standard output is left as it is: a report may be piped somewhere.
    with Bars(*columns, console=Console(stderr=True), redirect_stdout=False) as bars:

        def tell(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(f"{title}: {what}", total=total)
            elif done == 1:  # the next method begins
                bars.reset(tasks[what])
            bars.update(tasks[what], completed=done)

        yield tell
