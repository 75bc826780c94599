"""Libraries that only studies need; the service runs without them."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module

from schemas.errors import SetupError

FOR_REPORTS = ("jinja2", "matplotlib")
FOR_FITTING = ("scipy",)


@contextmanager
def for_studies() -> Iterator[None]:
    """A block that imports such libraries; raises SetupError, which says how to install one that is missing."""
    try:
        yield
    except ModuleNotFoundError as missing:
        raise SetupError(
            f"studies need {missing.name}, which is not installed: "
            f"`.venv/bin/pip install {missing.name}`, or `./revisit test`"
        ) from None


def require(names: tuple[str, ...]) -> None:
    """Import libraries before a long run that needs them at its end; raises SetupError."""
    with for_studies():
        for name in names:
            import_module(name)
