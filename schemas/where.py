"""Conditions on views, as JSON in the manner of MongoDB, which vector databases speak too.

``{"place": {"$prefix": "floor2/"}, "$not": {"metadata.camera": "rear"}}``: a field with a value or operators, or a
word of logic with conditions; what stands side by side must all hold.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal, get_args

from schemas import values

TEXTS = ("place", "filename")
NUMBERS = ("x", "y", "z", "lat", "lon", "alt", "heading")
TIMES = ("captured_at", "enrolled_at")
_METADATA = "metadata."

LONGEST = 4000
"""Characters."""

MOST = 64
"""Comparisons."""

DEEPEST = 8
"""Levels of logic."""

LONGEST_VALUE = 1000

EXACT = 2**53
"""Integers from here on are no exact float64."""

Number = float | int
"""A float; an int only from `EXACT` on: stamps in nanoseconds are such."""

Value = str | Number | bool | datetime
Ordering = Literal["$gt", "$gte", "$lt", "$lte"]
ORDERINGS: tuple[Ordering, ...] = get_args(Ordering)
OPERATORS = ("$eq", "$ne", *ORDERINGS, "$in", "$nin", "$prefix", "$exists")


@dataclass(frozen=True)
class Is:
    """A field has one of these values, each of the same type as the field's."""

    path: tuple[str, ...]
    values: tuple[Value, ...]


@dataclass(frozen=True)
class Compared:
    """A number or a time stands in this order to a bound."""

    path: tuple[str, ...]
    operator: Ordering
    bound: Number | datetime


@dataclass(frozen=True)
class Begins:
    """A text begins so."""

    path: tuple[str, ...]
    prefix: str


@dataclass(frozen=True)
class Exists:
    """A field has a value."""

    path: tuple[str, ...]


@dataclass(frozen=True)
class Not:
    """A condition does not hold."""

    condition: "Predicate"


@dataclass(frozen=True)
class AllOf:
    """Every condition holds."""

    conditions: tuple["Predicate", ...]


@dataclass(frozen=True)
class AnyOf:
    """At least one condition holds."""

    conditions: tuple["Predicate", ...]


Predicate = Is | Compared | Begins | Exists | Not | AllOf | AnyOf
"""Of a view without the field nothing but `Not` holds. `path`: a field's name, or ``metadata`` and keys in it."""


def condition(text: object) -> Predicate:
    """Parse a condition, as text or parsed JSON; raises ValueError with what is wrong in it."""
    if isinstance(text, str):
        if len(text) > LONGEST:
            raise ValueError(f"must not be longer than {LONGEST} characters")
        text = values.strict_json(text)
    found = _all(text, 1)
    if (count := _comparisons(found)) > MOST:
        raise ValueError(f"has {count} comparisons; at most {MOST} are taken")
    return found


def _all(value: object, depth: int) -> Predicate:
    if depth > DEEPEST:
        raise ValueError(f"must not be nested deeper than {DEEPEST} levels")
    if not isinstance(value, dict) or not value:
        raise ValueError(f"needs a JSON object with at least one field or one of $and, $or, $not, not {_shown(value)}")
    parts = [_logic(key, inner, depth) if key.startswith("$") else _field(key, inner) for key, inner in value.items()]
    return parts[0] if len(parts) == 1 else AllOf(tuple(parts))


def _logic(word: str, value: object, depth: int) -> Predicate:
    if word == "$not":
        return Not(_all(value, depth + 1))
    if word not in ("$and", "$or"):
        raise ValueError(f"{word} is no word of logic: $and, $or, $not are; operators stand behind a field")
    if not isinstance(value, list) or not value:
        raise ValueError(f"{word} needs a list of conditions, not {_shown(value)}")
    parts = tuple(_all(one, depth + 1) for one in value)
    return AllOf(parts) if word == "$and" else AnyOf(parts)


def _field(name: str, value: object) -> Predicate:
    path = _path(name)
    if not isinstance(value, dict):
        return Is(path, (_value(path, value),))
    if not value:
        raise ValueError(f"{name} needs a value or an operator")
    parts = [_operator(path, operator, operand) for operator, operand in value.items()]
    return parts[0] if len(parts) == 1 else AllOf(tuple(parts))


def _path(name: str) -> tuple[str, ...]:
    if name in (*TEXTS, *NUMBERS, *TIMES):
        return (name,)
    keys = name.removeprefix(_METADATA).split(".") if name.startswith(_METADATA) else []
    if not keys:
        known = ", ".join((*TEXTS, *NUMBERS, *TIMES))
        raise ValueError(f"{name!r} is no field: {known} and metadata.KEY are, also metadata.KEY.KEY")
    if len(keys) > values.METADATA_DEPTH or not all(keys):
        raise ValueError(f"{name!r} needs one to {values.METADATA_DEPTH} keys with dots between them")
    for key in keys:
        if re.search(r"[\"\\\x00-\x1f]", key) or re.fullmatch(r"-?[0-9]+", key):
            raise ValueError(f"{name!r}: keys that are numbers, or with quotes or backslashes, cannot be looked into")
    return ("metadata", *keys)


def _operator(path: tuple[str, ...], operator: str, operand: object) -> Predicate:
    name = ".".join(path)
    if operator not in OPERATORS:
        raise ValueError(f"{name}: {operator} is no operator: {', '.join(OPERATORS)} are")
    if operator == "$exists":
        if not isinstance(operand, bool):
            raise ValueError(f"{name}: $exists needs true or false")
        return Exists(path) if operand else Not(Exists(path))
    if operator in ("$in", "$nin"):
        if not isinstance(operand, list) or not 1 <= len(operand) <= MOST:
            raise ValueError(f"{name}: {operator} needs a list of 1 to {MOST} values")
        member = Is(path, tuple(_value(path, one) for one in operand))
        return member if operator == "$in" else Not(member)
    value = _value(path, operand)
    if operator == "$prefix":
        if not isinstance(value, str):
            raise ValueError(f"{name}: $prefix needs a text")
        return Begins(path, value)
    if operator in ("$eq", "$ne"):
        return Is(path, (value,)) if operator == "$eq" else Not(Is(path, (value,)))
    if isinstance(value, str | bool):
        raise ValueError(f"{name}: {operator} needs a number, or of {' and '.join(TIMES)} a time")
    return Compared(path, next(one for one in ORDERINGS if one == operator), value)


_TYPES: Mapping[str, tuple[Callable[[object], bool], str]] = {
    **dict.fromkeys(TEXTS, (lambda value: isinstance(value, str), "a text")),
    **dict.fromkeys(NUMBERS, (lambda value: isinstance(value, float), "a number")),
    "metadata": (lambda value: isinstance(value, str | Number | bool), "a text, a number, true or false"),
}


def _value(path: tuple[str, ...], value: object) -> Value:
    """A value of the type that the field has; numbers as float, those of metadata that no float is as int."""
    name = ".".join(path)
    if path[0] in TIMES:
        try:
            return values.moment(value)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
    if isinstance(value, int) and not isinstance(value, bool):
        try:
            nearest = float(value)
        except OverflowError:
            raise ValueError(f"{name}: the number is too large") from None
        value = value if path[0] == "metadata" and abs(value) >= EXACT else nearest
    fits, wanted = _TYPES[path[0]]
    if not fits(value):
        raise ValueError(f"{name}: needs {wanted}, not {_shown(value)}")
    if isinstance(value, str) and (len(value) > LONGEST_VALUE or "\0" in value):
        raise ValueError(f"{name}: a text has at most {LONGEST_VALUE} characters, none of them U+0000")
    assert isinstance(value, str | Number | bool)
    return value


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:80]}…"


def _comparisons(one: Predicate) -> int:
    if isinstance(one, AllOf | AnyOf):
        return sum(map(_comparisons, one.conditions))
    if isinstance(one, Not):
        return _comparisons(one.condition)
    return len(one.values) if isinstance(one, Is) else 1
