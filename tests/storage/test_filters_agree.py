"""Random conditions over random metadata choose the same views from memory, from either database, and as they say."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from schemas.records import Filters, ViewAttributes
from schemas.where import condition
from tests.storage.material import enroll, ids
from tests.storage.test_where import holds
from worker.storage.filter_cache import FilterCache
from worker.storage.filtering import metadata_pairs, text_of
from worker.storage.store import SqlStore

COUNT = 4
KEYS = st.sampled_from(["a", "A", "b", "a b", "ü", "\U0001f600", "it's", "$", "[0]", "+1", " 1", "1.5e"])
TEXTS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=3)
EDGES = [2**53, 2**53 + 1, 2**62 + 1, 2**63 - 1, -(2**63), 9007199254740992.0, 1e22, 5e-324, -0.0, 0.1, 0.1 + 0.2]
NUMBERS = st.integers(-3, 3) | st.floats(allow_nan=False, allow_infinity=False) | st.sampled_from(EDGES)
SCALARS: st.SearchStrategy[Any] = NUMBERS | TEXTS | st.booleans()
VALUES: st.SearchStrategy[Any] = st.recursive(
    SCALARS | st.none(),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(KEYS, inner, max_size=2),
    max_leaves=4,
)
DOCUMENTS = st.dictionaries(KEYS, VALUES, max_size=4)


def scalars(value: Any) -> list[Any]:
    """What conditions may name of a document."""
    if isinstance(value, dict | list):
        return [one for inner in (value.values() if isinstance(value, dict) else value) for one in scalars(inner)]
    return [] if value is None else [value]


@st.composite
def comparisons(draw: st.DrawFn, known: list[Any]) -> dict[str, Any]:
    """One comparison, mostly with a value that some document has, or with its neighbour."""
    path = ".".join(["metadata", *draw(st.lists(KEYS.filter(lambda key: "." not in key), min_size=1, max_size=2))])
    value = draw(SCALARS | st.sampled_from(known) if known else SCALARS)
    if isinstance(value, int) and not isinstance(value, bool):
        value += draw(st.sampled_from([0, 0, 1, -1]))
    if isinstance(value, str):
        operators = ["$eq", "$ne", "$in", "$prefix", "$exists"]
    else:
        operators = ["$eq", "$ne", "$in", "$exists"] + ["$gt", "$gte", "$lt", "$lte"] * (not isinstance(value, bool))
    operator = draw(st.sampled_from(operators))
    wrapped = {"$in": [value, draw(SCALARS)], "$exists": draw(st.booleans())}
    return {path: {operator: wrapped.get(operator, value)}}


def conditions(known: list[Any]) -> st.SearchStrategy[dict[str, Any]]:
    """Any of them, nested."""
    return st.recursive(
        comparisons(known),
        lambda inner: (
            st.builds(lambda one: {"$not": one}, inner)
            | st.builds(lambda word, many: {word: many}, st.sampled_from(["$and", "$or"]), st.lists(inner, min_size=1))
        ),
        max_leaves=4,
    )


@pytest.fixture
def few(store: SqlStore) -> SqlStore:
    for number in range(COUNT):
        enroll(store, f"image {number}")
    return store


@given(data=st.data(), documents=st.lists(DOCUMENTS, min_size=COUNT, max_size=COUNT))
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
def test_memory_and_databases_choose_what_a_filter_says(
    few: SqlStore, data: st.DataObject, documents: list[Mapping[str, Any]]
) -> None:
    views = few.views.list("campus", Filters())[0]
    for view, document in zip(views, documents, strict=True):
        few.views.change(view.id, lambda known, to=document: replace(known, metadata=to))  # type: ignore[misc]
    known = [one for document in documents for one in scalars(document)]
    few.listings._columns = FilterCache(few._database, settled_s=0.0)
    for _ in range(4):
        where = data.draw(conditions(known))
        parsed = condition(where)
        agree(few, Filters(where=parsed), [holds(parsed, ViewAttributes(metadata=one)) for one in documents])
    for document in documents:
        for key, value in document.items():
            pairs = {key: text_of(value)}
            wanted = metadata_pairs({key: value})
            agree(few, Filters(metadata=pairs), [wanted[0] in metadata_pairs(one) for one in documents])


def test_a_float_is_not_the_whole_number_beside_it(few: SqlStore) -> None:
    """Stamps in nanoseconds that came through a float, asked for as they were before."""
    stamps = [2.0**53, 2.0**53 + 2, 1.7e18, 2**53 + 1]
    for view, stamp in zip(few.views.list("campus", Filters())[0], stamps, strict=True):
        few.views.change(view.id, lambda known, to=stamp: replace(known, metadata={"t": to, "f": float(to)}))  # type: ignore[misc]
    few.listings._columns = FilterCache(few._database, settled_s=0.0)
    for operator in ("$eq", "$gt", "$gte", "$lt", "$lte"):
        for bound in (2**53 + 1, 17 * 10**17, 17 * 10**17 - 1):
            where = condition({"metadata.f": {operator: bound}})
            agree(few, Filters(where=where), [holds(where, ViewAttributes(metadata={"f": float(to)})) for to in stamps])


def agree(store: SqlStore, filters: Filters, meant: list[bool]) -> None:
    """The database, then columns in memory, choose the views that are meant."""
    views = store.views.list("campus", Filters())[0]
    expected = [view for view, chosen in zip(views, meant, strict=True) if chosen]
    assert ids(store.views.list("campus", filters)[0]) == ids(expected)
    for _ in range(2):
        only = store.listings.select("campus", filters).only
        store.listings._columns.wait()
        assert only is not None
        assert only.tolist() == [view.seq for view in expected]
