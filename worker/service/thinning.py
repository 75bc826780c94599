"""Leave out images of a recording that were taken soon, or near, after the one before."""

from collections.abc import Callable

from schemas.errors import InvalidParameters
from schemas.imports import ImportOptions
from schemas.records import ViewAttributes
from worker.method.positions import distance, is_known
from worker.service.recordings import Note, Recording

SLACK = 1e-6
"""Share of a step by which two images may be closer: times and positions are rounded."""


def thin(recording: Recording, options: ImportOptions) -> list[int]:
    """Leave out items that are less than a step after the last one that stays.

    Items without the time or the position that steps are measured by are left out and noted. Notes that an item is
    enrolled without a position go where that item is left out.

    Returns
    -------
    list of int
        Indices of the items that stay, among all that there were, ascending.

    Raises
    ------
    InvalidParameters
        No item has such a time or position.
    """
    kept, notes = list(range(len(recording.items))), list[Note]()
    if options.every_s is not None:
        kept, notes = _apart(recording, "time", _timed, _seconds, options.every_s)
    elif options.every_m is not None:
        kept, notes = _apart(recording, "position", _placed, _metres, options.every_m)
    left = {item.file for item in recording.items} - {recording.items[at].file for at in kept}
    recording.notes = [note for note in recording.notes if note.problem != "no-row" or note.file not in left] + notes
    recording.left_out += len(recording.items) - len(kept)
    recording.items = [recording.items[at] for at in kept]
    return kept


def _apart(
    recording: Recording,
    what: str,
    known: Callable[[ViewAttributes], bool],
    between: Callable[[ViewAttributes, ViewAttributes], float],
    step: float,
) -> tuple[list[int], list[Note]]:
    kept: list[int] = []
    notes: list[Note] = []
    last: ViewAttributes | None = None
    for at, item in enumerate(recording.items):
        if not known(item.attributes):
            detail = f"has no {what}, by which `every` chooses; it was left out"
            notes.append(Note(item.file, "no-row", detail))
        elif last is None or between(last, item.attributes) >= step * (1 - SLACK):
            kept.append(at)
            last = item.attributes
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
