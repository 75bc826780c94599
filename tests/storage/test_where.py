"""Conditions choose the same views in either database, and those that they say."""

import json
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from operator import ge, gt, le, lt
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from schemas.records import Filters, Position, ViewAttributes
from schemas.where import (
    DEEPEST,
    LONGEST,
    MOST,
    AllOf,
    AnyOf,
    Begins,
    Compared,
    Exists,
    Is,
    Not,
    Predicate,
    condition,
)
from tests.storage.material import NOW, enroll
from worker.storage.filter_cache import FilterCache
from worker.storage.store import SqlStore

MOMENT = datetime(2026, 3, 1, 9, 30, tzinfo=UTC)
STAMP = 1_772_357_400_123_456_789
"""Nanoseconds, as ROS counts them: no float64 is this number."""

VIEWS: Mapping[str, ViewAttributes] = {
    "gate": ViewAttributes(
        "floor1/gate",
        Position(x=1.5, y=2.0, heading=350.0),
        MOMENT,
        {"floor": 1, "level": 1, "camera": "front", "stamp": STAMP},
    ),
    "hall": ViewAttributes(
        "floor2/hall",
        Position(x=-3.0, y=0.0),
        MOMENT + timedelta(days=1),
        {"floor": 2.5, "level": 2.5, "lit": True, "stamp": STAMP + 1},
    ),
    "yard": ViewAttributes(
        "Floor2/yard", Position(lat=52.0, lon=13.0, alt=40.0), None, {"floor": "2", "level": "2", "lit": False}
    ),
    "attic": ViewAttributes(
        None, Position(), None, {"a": {"b": {"c": 7}, "list": [1, 2]}, "none": None, "floor": 10**400}
    ),
    "shed": ViewAttributes("100%_sure", Position(), None, {"camera": 'it\'s "front"', "überall": "ja", "a b": 0.1}),
}


@pytest.fixture
def five(store: SqlStore) -> SqlStore:
    for name, attributes in VIEWS.items():
        enroll(store, name, attributes=replace(attributes, filename=f"{name}.jpg"))
    store.listings._columns = FilterCache(store._database, settled_s=0.0)
    return store


def names(store: SqlStore, text: str | Mapping[str, Any]) -> set[str]:
    filters = Filters(where=condition(text if isinstance(text, str) else json.dumps(text)))
    views, _ = store.views.list("campus", filters, state=None, cursor=None, limit=50)
    return {str(view.attributes.filename).removesuffix(".jpg") for view in views}


EVERY = set(VIEWS)


@pytest.mark.parametrize(
    ("where", "found"),
    [
        ({"place": "floor2/hall"}, {"hall"}),
        ({"place": {"$prefix": "floor2/"}}, {"hall"}),  # capitals matter
        ({"place": {"$prefix": "100%_"}}, {"shed"}),
        ({"place": {"$ne": "floor2/hall"}}, EVERY - {"hall"}),
        ({"place": {"$exists": False}}, {"attic"}),
        ({"place": {"$in": ["floor1/gate", "nowhere"]}}, {"gate"}),
        ({"place": {"$nin": ["floor1/gate"]}}, EVERY - {"gate"}),
        ({"filename": {"$prefix": "ya"}}, {"yard"}),
        ({"x": {"$gte": -3, "$lt": 1.5}}, {"hall"}),
        ({"heading": {"$gt": 349}}, {"gate"}),
        ({"alt": 40}, {"yard"}),
        ({"captured_at": {"$gt": "2026-03-01T09:30:00Z"}}, {"hall"}),
        ({"captured_at": "2026-03-01T10:30:00+01:00"}, {"gate"}),
        ({"enrolled_at": {"$lte": NOW.isoformat()}}, EVERY),
        ({"metadata.floor": 1}, {"gate"}),
        ({"metadata.floor": "2"}, {"yard"}),  # a text is no number
        ({"metadata.floor": {"$gte": 1}}, {"gate", "hall", "attic"}),
        ({"metadata.floor": {"$lt": 1e308}}, {"gate", "hall"}),
        ({"metadata.stamp": STAMP}, {"gate"}),
        ({"metadata.stamp": {"$in": [STAMP, STAMP - 1]}}, {"gate"}),
        ({"metadata.stamp": {"$gt": STAMP}}, {"hall"}),
        ({"metadata.stamp": {"$lte": STAMP + 10**30}}, {"gate", "hall"}),
        ({"metadata.lit": True}, {"hall"}),
        ({"metadata.lit": {"$ne": True}}, EVERY - {"hall"}),
        ({"metadata.lit": 1}, set()),
        ({"metadata.none": {"$exists": True}}, {"attic"}),
        ({"metadata.a.b.c": {"$in": [6, 7]}}, {"attic"}),
        ({"metadata.a.list.b": {"$exists": True}}, set()),
        ({"metadata.a.b": "x"}, set()),
        ({"metadata.camera": 'it\'s "front"'}, {"shed"}),
        ({"metadata.überall": "ja", "metadata.a b": 0.1}, {"shed"}),
        ({"$or": [{"metadata.floor": 1}, {"place": {"$exists": False}}]}, {"gate", "attic"}),
        ({"$not": {"$or": [{"x": {"$exists": True}}, {"lat": {"$exists": True}}]}}, {"attic", "shed"}),
        ({"$and": [{"metadata.floor": {"$gt": 0}}, {"metadata.floor": {"$lt": 2}}]}, {"gate"}),
    ],
)  # fmt: skip
def test_a_condition_chooses_what_it_says(five: SqlStore, where: Mapping[str, Any], found: set[str]) -> None:
    assert names(five, where) == found
    assert names(five, {"$not": dict(where)}) == EVERY - found


def test_conditions_and_other_filters_must_all_hold(five: SqlStore) -> None:
    one = Filters(where=condition({"metadata.floor": {"$gte": 1}}), metadata={"camera": "front"})
    assert len(five.views.list("campus", one, state=None, cursor=None, limit=50)[0]) == 1
    assert five.listings.select("campus", Filters(where=condition({"x": {"$gt": 100}}))).only is not None


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "is not JSON"),
        ("[]", "needs a JSON object"),
        ("{}", "at least one field"),
        ('{"floor": 1}', "'floor' is no field: place, filename, x"),
        ('{"metadata": 1}', "'metadata' is no field"),
        ('{"metadata.": 1}', "needs one to 8 keys"),
        ('{"metadata.a..b": 1}', "needs one to 8 keys"),
        ('{"metadata.a.0": 1}', "keys that are numbers"),
        (json.dumps({'metadata.a"b': 1}), "with quotes or backslashes"),
        ('{"place": {"$like": "a"}}', r"\$like is no operator: \$eq"),
        ('{"place": {"a": 1}}', "a is no operator"),
        ('{"place": {}}', "needs a value or an operator"),
        ('{"place": 1}', "place: needs a text, not 1.0"),
        ('{"place": null}', "place: needs a text, not None"),
        ('{"place": {"$gt": "a"}}', r"\$gt needs a number"),
        ('{"x": "1"}', "x: needs a number"),
        ('{"x": true}', "x: needs a number"),
        ('{"x": NaN}', "not JSON"),
        ('{"x": {"$prefix": 1}}', r"\$prefix needs a text"),
        ('{"captured_at": "today"}', "captured_at: "),
        ('{"captured_at": 5}', "captured_at: "),
        ('{"metadata.a": [1]}', "needs a text, a number, true or false"),
        ('{"metadata.a": {"$in": []}}', "list of 1 to 64"),
        ('{"metadata.a": {"$in": 3}}', "list of 1 to 64"),
        ('{"metadata.a": {"$exists": 1}}', r"\$exists needs true or false"),
        ('{"metadata.a": "\\u0000"}', "U[+]0000"),
        ('{"$xor": [{"x": 1}]}', r"\$xor is no word of logic"),
        ('{"$gt": 1}', r"\$gt is no word of logic"),
        ('{"$and": {"x": 1}}', r"\$and needs a list"),
        ('{"$or": []}', r"\$or needs a list"),
        ('{"$not": [{"x": 1}]}', "needs a JSON object"),
        ('{"x": 1, "x": 2}', "twice"),
        ('{"$not":' * DEEPEST + '{"x": 1}' + "}" * DEEPEST, "nested deeper"),
        (json.dumps({"x": {"$in": list(range(MOST))}, "y": 1}), "65 comparisons"),
        (" " * (LONGEST + 1), "longer than 4000"),
        (f'{{"metadata.a": 1{"0" * 400}}}', "too large"),
    ],
)  # fmt: skip
def test_what_is_no_condition_is_refused_with_the_reason(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        condition(text)


FIELDS = (
    "place",
    "x",
    "captured_at",
    "metadata.floor",
    "metadata.level",
    "metadata.lit",
    "metadata.stamp",
    "metadata.a.b.c",
    "metadata.nothing",
)
VALUES: Mapping[str, st.SearchStrategy[Any]] = {
    "place": st.sampled_from(["floor1/gate", "floor2/", "", "100%_sure", "ü"]),
    "x": st.sampled_from([-3, 0, 1.5, 1e300]),
    "captured_at": st.sampled_from([MOMENT.isoformat(), (MOMENT + timedelta(days=1)).isoformat()]),
}
OF_METADATA = st.sampled_from([1, 2.5, 7, "2", "front", "", True, False, -1e308, STAMP, -(10**30)])


@st.composite
def comparisons(draw: st.DrawFn) -> dict[str, Any]:
    field = draw(st.sampled_from(FIELDS))
    value = draw(VALUES.get(field, OF_METADATA))
    ordered = field in ("x", "captured_at") or (isinstance(value, int | float) and not isinstance(value, bool))
    operators = ["$eq", "$ne", "$in", "$exists"] + ["$gt", "$gte", "$lt", "$lte"] * ordered
    operators += ["$prefix"] * (isinstance(value, str) and field != "captured_at")
    operator = draw(st.sampled_from(operators))
    return {field: {operator: {"$in": [value], "$exists": draw(st.booleans())}.get(operator, value)}}


CONDITIONS = st.recursive(
    comparisons(),
    lambda inner: (
        st.builds(lambda one: {"$not": one}, inner)
        | st.builds(lambda many: {"$or": many}, st.lists(inner, min_size=1, max_size=3))
        | st.builds(lambda many: {"$and": many}, st.lists(inner, min_size=1, max_size=3))
    ),
    max_leaves=6,
)


COMPARE = {"$gt": gt, "$gte": ge, "$lt": lt, "$lte": le}


def value_of(view: ViewAttributes, path: tuple[str, ...]) -> Any:
    """The value, or `value_of` itself where there is none."""
    if path[0] == "metadata":
        found: Any = view.metadata
        for key in path[1:]:
            if not isinstance(found, dict) or key not in found:
                return value_of
            found = found[key]
        return found
    known = getattr(view, path[0], None) if hasattr(view, path[0]) else getattr(view.position, path[0])
    return value_of if known is None else known


def alike(one: Any, other: Any) -> bool:
    """Whether two values are of one type of JSON."""
    numbers = [isinstance(v, int | float) and not isinstance(v, bool) for v in (one, other)]
    return all(numbers) or (not any(numbers) and type(one) is type(other))


def holds(one: Predicate, view: ViewAttributes) -> bool:
    """What a condition means."""
    if isinstance(one, AllOf | AnyOf):
        return (all if isinstance(one, AllOf) else any)(holds(part, view) for part in one.conditions)
    if isinstance(one, Not):
        return not holds(one.condition, view)
    value = value_of(view, one.path)
    if isinstance(one, Exists):
        return value is not value_of
    if isinstance(one, Is):
        return any(alike(value, wanted) and value == wanted for wanted in one.values)
    if isinstance(one, Begins):
        return isinstance(value, str) and value.startswith(one.prefix)
    assert isinstance(one, Compared)
    if not alike(value, one.bound):
        return False
    return bool(COMPARE[one.operator](value, one.bound))


@given(where=CONDITIONS)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_database_means_what_a_condition_means(five: SqlStore, where: dict[str, Any]) -> None:
    parsed = condition(where)
    meant = {name for name, view in VIEWS.items() if holds(parsed, view)}
    found = five.views.list("campus", Filters(where=parsed), limit=50)[0]
    assert {str(view.attributes.filename).removesuffix(".jpg") for view in found} == meant
    for _ in range(2):  # by the database, then from columns in memory
        only = five.listings.select("campus", Filters(where=parsed)).only
        five.listings._columns.wait()
        assert only is not None
        assert only.tolist() == [view.seq for view in found]
