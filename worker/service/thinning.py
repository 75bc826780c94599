"""Leave out images of a recording that were taken soon, or near, after the one before."""

from collections.abc import Callable, Sequence

from schemas.errors import InvalidParameters
from schemas.imports import ImportOptions
from schemas.records import ViewAttributes
from worker.method.estimate import distance, is_known
from worker.service.recordings import Item, Note

SLACK = 1e-6
"""Share of a step by which two images may be closer: times and positions are rounded."""


def thinned(items: Sequence[Item], options: ImportOptions) -> tuple[list[Item], list[Note]]:
    """Items at least a step apart, in their order, and notes on those of which that cannot be told.

    Raises
    ------
    InvalidParameters
        It can be told of none.
    """
    if options.every_s is not None:
        return _apart(items, "time", _timed, _seconds, options.every_s)
    if options.every_m is not None:
        return _apart(items, "position", _placed, _metres, options.every_m)
    return list(items), []


def _apart(
    items: Sequence[Item],
    what: str,
    known: Callable[[ViewAttributes], bool],
    between: Callable[[ViewAttributes, ViewAttributes], float],
    step: float,
) -> tuple[list[Item], list[Note]]:
    kept: list[Item] = []
    notes: list[Note] = []
    for item in items:
        if not known(item.attributes):
            notes.append(Note(item.file, "no-row", f"has no {what}, by which `every` chooses; it was left out"))
        elif not kept or between(kept[-1].attributes, item.attributes) >= step * (1 - SLACK):
            kept.append(item)
    if not kept:
        raise InvalidParameters.of("every", f"no image of the recording has a {what} in a manifest or trajectory")
    return kept, notes


def _timed(attributes: ViewAttributes) -> bool:
    return attributes.captured_at is not None


def _placed(attributes: ViewAttributes) -> bool:
    return is_known(attributes.position)


def _seconds(one: ViewAttributes, other: ViewAttributes) -> float:
    assert one.captured_at is not None
    assert other.captured_at is not None
    return abs((other.captured_at - one.captured_at).total_seconds())


def _metres(one: ViewAttributes, other: ViewAttributes) -> float:
    return distance(one.position, other.position)
