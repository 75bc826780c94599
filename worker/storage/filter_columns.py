"""What views are filtered by, in memory: one column for each field that filters named, as of one revision of a map.

A condition reads every view of a map. In SQL that takes longer than the search of a large map; over arrays it does not.
The database stays the truth: columns are read when a field is filtered by, follow what is enrolled and deleted, and are
gone when attributes of a view change.
"""

import json
import sys
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from itertools import compress
from typing import Any

import numpy as np
import numpy.typing as npt
import sqlalchemy as sa

from schemas.records import Sequence64
from schemas.where import EXACT, TEXTS, TIMES, Number, Value
from worker.storage.filtering import text_of
from worker.storage.tables import VIEWS

Mask = npt.NDArray[np.bool_]

Path = tuple[str, ...]
"""A column of `views`, or ``metadata`` and keys; ``=`` and a key: the text of what is under that key."""

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MICROSECOND = 1_000_000


class NotExact(Exception):
    """A field has a number that float64 cannot hold exactly: the database has to compare it."""


@dataclass(frozen=True, eq=False)
class Column:
    """A field of each view, apart by type; a part that no view has is None.

    Parameters
    ----------
    exists : bool of shape (n,)
        Whether the view has the field.
    numbers : float64 of shape (n,), or int64 for times
        Times in microseconds since 1970; see `is_number`.
    is_number, is_true, is_false : bool of shape (n,)
    codes : int32 of shape (n,)
        Indices into `texts`, -1 where it is no text.
    texts : list of str
        Different ones, by code point.
    texts_size : int
        Bytes that these take.
    """

    exists: Mask
    numbers: "npt.NDArray[Any] | None" = None
    is_number: Mask | None = None
    is_true: Mask | None = None
    is_false: Mask | None = None
    codes: npt.NDArray[np.int32] | None = None
    texts: Sequence[str] = ()
    texts_size: int = 0

    @cached_property
    def size(self) -> int:
        """Bytes in memory."""
        arrays = (self.exists, self.numbers, self.is_number, self.is_true, self.is_false, self.codes)
        return sum(one.nbytes for one in arrays if one is not None) + self.texts_size

    def without(self, gone: Mask) -> "Column":
        """The column of the other views."""
        kept = ~gone
        return Column(
            self.exists[kept],
            _selected(self.numbers, kept),
            _selected(self.is_number, kept),
            _selected(self.is_true, kept),
            _selected(self.is_false, kept),
            _selected(self.codes, kept),
            self.texts,
            self.texts_size,
        )

    def with_further(self, other: "Column") -> "Column":
        """The column of these views followed by `other` ones; both are of one field."""
        texts, old, new, more = _merged(self.texts, other.texts)
        return Column(
            np.concatenate([self.exists, other.exists]),
            _joined(self.numbers, other.numbers),
            _joined(self.is_number, other.is_number),
            _joined(self.is_true, other.is_true),
            _joined(self.is_false, other.is_false),
            _joined(_coded(self.codes, old), _coded(other.codes, new)),
            texts,
            self.texts_size + more,
        )

    def known_numbers(self) -> "npt.NDArray[Any]":
        """The numbers, NaN where there is none; of a column of numbers."""
        assert self.numbers is not None
        return self.numbers

    def _none(self) -> Mask:
        return np.zeros(len(self.exists), np.bool_)

    def equal(self, value: Value) -> Mask:
        """The views whose field has this value and its type."""
        if isinstance(value, bool):
            found = self.is_true if value else self.is_false
            return self._none() if found is None else found
        if isinstance(value, str):
            at = bisect_left(self.texts, value)
            known = at < len(self.texts) and self.texts[at] == value
            return self.codes == at if known and self.codes is not None else self._none()
        return self.compared("$eq", value)

    def compared(self, operator: str, bound: Number | datetime) -> Mask:
        """The views whose field is a number or a time that stands in this order to a bound; raises NotExact."""
        if self.numbers is None or self.is_number is None:
            return self._none()
        if isinstance(bound, int) and abs(bound) >= EXACT:  # as float64 it might be another number
            raise NotExact
        limit = micros(bound) if isinstance(bound, datetime) else bound
        compare = {"$eq": np.equal, "$gt": np.greater, "$gte": np.greater_equal, "$lt": np.less, "$lte": np.less_equal}
        found: Mask = compare[operator](self.numbers, limit) & self.is_number
        return found

    def begins(self, prefix: str) -> Mask:
        """The views whose field is a text with this prefix: such texts lie side by side in `texts`."""
        if self.codes is None:
            return self._none()
        low = bisect_left(self.texts, prefix)
        high = bisect_right(self.texts, prefix, lo=low, key=lambda text: text[: len(prefix)])
        found: Mask = (self.codes >= low) & (self.codes < high)
        return found


def _selected(part: "npt.NDArray[Any] | None", kept: Mask) -> "npt.NDArray[Any] | None":
    return None if part is None else part[kept]


def _joined(first: "npt.NDArray[Any] | None", second: "npt.NDArray[Any] | None") -> "npt.NDArray[Any] | None":
    return None if first is None or second is None else np.concatenate([first, second])


Codes = npt.NDArray[np.int64]


def _merged(known: Sequence[str], others: Sequence[str]) -> tuple[Sequence[str], Codes | None, Codes, int]:
    """Merge two lists of texts that are sorted by code point.

    Only new texts are sorted in: a field may have as many texts as there are views.

    Returns
    -------
    texts : sequence of str
    known_codes : int64 of shape (known,), or None
        The index in `texts` of each of `known`; None where these stay as they are.
    other_codes : int64 of shape (others,)
        The index in `texts` of each of `others`.
    new_bytes : int
        Memory of the texts that are only in `others`.
    """
    positions = [bisect_left(known, text) for text in others]
    is_new = [not (place < len(known) and known[place] == text) for place, text in zip(positions, others, strict=True)]
    places, fresh = np.array(positions, np.int64), np.array(is_new, np.bool_)
    if not fresh.any():
        return known, None, places, 0
    texts: list[str] = []
    start = 0
    for place, text in zip(places[fresh].tolist(), compress(others, is_new), strict=True):
        texts += known[start:place]
        texts.append(text)
        start = place
    texts += known[start:]
    before = np.arange(len(known)) + np.searchsorted(places[fresh], np.arange(len(known)), side="right")
    return texts, before, places + np.cumsum(fresh) - fresh, sum(map(sys.getsizeof, compress(others, is_new)))


def _coded(codes: "npt.NDArray[np.int32] | None", to: Codes | None) -> "npt.NDArray[np.int32] | None":
    """Codes replaced by the new code that `to` has for each; -1 stays. With None for `to`, all codes stay."""
    return codes if codes is None or to is None else np.append(to, -1).astype(np.int32)[codes]


def read(connection: sa.Connection, map_id: int, path: Path, after: int = 0) -> tuple[Sequence64, Column]:
    """Views of a map with sequence numbers above `after`, ascending, and a field of each of them; raises NotExact."""
    name = path[0] if path[0] in VIEWS.c else "metadata"
    wanted = sa.select(VIEWS.c.seq, VIEWS.c[name]).where(VIEWS.c.map_id == map_id, VIEWS.c.seq > after)
    rows = connection.execute(wanted.order_by(VIEWS.c.seq)).all()
    seqs = np.fromiter((row[0] for row in rows), np.int64, len(rows))
    fields: list[Any] = [row[1] for row in rows]
    if path[0] in TIMES:
        return seqs, _times(fields)
    if path[0] in TEXTS:
        return seqs, _texts(fields)
    if path[0] in VIEWS.c and path[0] != "metadata":
        numbers = np.array(fields, np.float64)  # None becomes NaN
        known = ~np.isnan(numbers)
        return seqs, Column(known, numbers, known)
    if path[0] == "=":
        return seqs, _texts(_each(fields, lambda document: _text_under(document, path[1])))
    return seqs, _mixed(_each(fields, lambda document: _value_at(document, path[1:])))


def micros(moment: datetime) -> int:
    """Microseconds since 1970."""
    since = moment - EPOCH
    return (since.days * 86400 + since.seconds) * MICROSECOND + since.microseconds


class _Missing:
    """Stands for a field that is not there."""


MISSING = _Missing()


def _each(documents: Iterable[object], field: Any) -> list[Any]:
    """A field of each document, by a function; equal documents, as metadata often are, are parsed once."""
    known: dict[object, Any] = {}
    found = []
    for text in documents:
        if text not in known:
            try:
                known[text] = field(json.loads(str(text)))
            except ValueError:  # damaged: it has no fields
                known[text] = MISSING
        found.append(known[text])
    return found


def _value_at(document: object, keys: Sequence[str]) -> object:
    for key in keys:
        if not isinstance(document, dict) or key not in document:
            return MISSING
        document = document[key]
    return document


def _text_under(document: object, key: str) -> object:
    return text_of(document[key]) if isinstance(document, dict) and key in document else MISSING


def _times(fields: Sequence[datetime | None]) -> Column:
    known = np.array([one is not None for one in fields], np.bool_)
    moments = np.array([0 if one is None else micros(one) for one in fields], np.int64)
    return Column(known, moments, known)


def _texts(fields: Sequence[object]) -> Column:
    """A column of texts; a field of any other type counts as missing."""
    texts = sorted({one for one in fields if isinstance(one, str)})
    code_of = {text: code for code, text in enumerate(texts)}
    codes = np.fromiter((code_of[one] if isinstance(one, str) else -1 for one in fields), np.int32, len(fields))
    return Column(codes >= 0, codes=codes, texts=texts, texts_size=sum(map(sys.getsizeof, texts)))


def _mixed(fields: Sequence[object]) -> Column:
    """A column of values of JSON; null, lists and objects exist and are equal to nothing."""
    exists = np.array([one is not MISSING for one in fields], np.bool_)
    is_number = np.array([isinstance(one, int | float) and not isinstance(one, bool) for one in fields], np.bool_)
    numbers = np.zeros(len(fields))
    for row in np.flatnonzero(is_number).tolist():
        number: Any = fields[row]
        if isinstance(number, int) and abs(number) >= EXACT:  # the column is left to the database
            raise NotExact
        numbers[row] = number
    texts = _texts(fields)
    is_true, is_false = (np.array([one is truth for one in fields], np.bool_) for truth in (True, False))
    return Column(exists, numbers, is_number, is_true, is_false, texts.codes, texts.texts, texts.texts_size)
