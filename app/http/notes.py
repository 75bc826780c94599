"""What is learnt of a request while it is answered, for its log line and the metrics."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field


@dataclass
class Notes:
    """Of one request.

    Parameters
    ----------
    path : str
        Its path as it came, without parameters.
    fields : dict
        Further fields of its log line.
    problems : list of str
        Codes of the errors that were answered; several images of one request may each have one.
    """

    path: str = ""
    fields: dict[str, object] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


_NOTES: ContextVar[Notes | None] = ContextVar("revisit_notes", default=None)


@contextmanager
def noting(path: str = "") -> Iterator[Notes]:
    """Collect the notes of the request that the block answers."""
    notes = Notes(path)
    token = _NOTES.set(notes)
    try:
        yield notes
    finally:
        _NOTES.reset(token)


def note(**fields: object) -> None:
    """Add fields to the log line of the present request: ids and numbers, nothing that is private to the caller."""
    notes = _NOTES.get()
    if notes is not None:
        notes.fields.update({name: value for name, value in fields.items() if value})


def note_problem(code: str) -> None:
    """Count an error of the present request."""
    notes = _NOTES.get()
    if notes is not None:
        notes.problems.append(code)


def noted_path() -> str:
    """The path of the present request; empty where there is none."""
    notes = _NOTES.get()
    return "" if notes is None else notes.path
