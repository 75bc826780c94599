"""While a process starts, nothing that it makes is garbage: the collector would look through it again and again."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def collecting_nothing() -> Iterator[None]:
    """Let the garbage collector rest, until `collecting_new` or the end."""
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def collecting_new() -> None:
    """Collect what is made from now on: what is there by now stays, and no collection looks through it any more."""
    gc.freeze()
    gc.enable()
