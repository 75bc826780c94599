"""What the log lines of one request or one job have in common; follows the work into threads.

A line written while fields are bound carries them: the request's id, a job's id, a view's id. The fields lie in a
context variable: coroutines and `asyncio.to_thread` inherit it; work given to another executor is run in
`contextvars.copy_context()`.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar

_NOTHING: Mapping[str, object] = {}
_FIELDS: ContextVar[Mapping[str, object]] = ContextVar("revisit_log_fields", default=_NOTHING)


@contextmanager
def bound(**fields: object) -> Iterator[None]:
    """Give every log line of the block these fields, besides those that are bound already."""
    token = _FIELDS.set({**_FIELDS.get(), **fields})
    try:
        yield
    finally:
        _FIELDS.reset(token)


def fields() -> Mapping[str, object]:
    """The fields that a log line written now carries."""
    return _FIELDS.get()
