"""Filters are exact, pages are stable, places lie in the middle of their views."""

import math
from datetime import timedelta
from itertools import pairwise

import numpy as np
import pytest

from schemas import values
from schemas.errors import InvalidParameters
from schemas.globe import EARTH_RADIUS_M
from schemas.records import Filters, Position, Selection, ViewAttributes
from tests.storage.material import NOW, RECIPE, enroll, ids
from worker.storage.paging import cursor_after
from worker.storage.store import SqlStore

MINUTE = timedelta(minutes=1)


def chosen(store: SqlStore, filters: Filters) -> set[int]:
    """The seqs that a selection leaves of all views; the listing must agree with it."""
    selection = store.listings.select("campus", filters)
    views, _ = store.views.list("campus", Filters(), limit=1000)
    seqs = {view.seq for view in views if selection.only is None or view.seq in selection.only}
    seqs -= set(selection.never.tolist())
    listed, _ = store.views.list("campus", filters, limit=1000)
    assert {view.seq for view in listed} == seqs
    for array in (selection.only, selection.never):
        assert array is None or (array.dtype == np.int64 and all(a < b for a, b in pairwise(array.tolist())))
    return seqs


def haversine(a: Position, b: Position) -> float:
    """Great-circle distance in metres, by the textbook."""
    assert a.lat is not None
    assert a.lon is not None
    assert b.lat is not None
    assert b.lon is not None
    phi_a, phi_b = math.radians(a.lat), math.radians(b.lat)
    h = (
        math.sin((phi_b - phi_a) / 2) ** 2
        + math.cos(phi_a) * math.cos(phi_b) * math.sin(math.radians(b.lon - a.lon) / 2) ** 2
    )
    return 2 * EARTH_RADIUS_M * math.asin(min(1.0, math.sqrt(h)))


def test_no_filter_restricts_nothing(store: SqlStore) -> None:
    enroll(store, "gate")
    selection = store.listings.select("campus", Filters())
    assert selection == Selection(None, selection.never)
    assert len(selection.never) == 0


@pytest.mark.parametrize("near", ["0,0,1.7e308", "1e9,-1e9,1e300", "3,4,5e9"])
def test_near_takes_any_radius(store: SqlStore, near: str) -> None:
    spots = [Position(x=1e9, y=1e9), Position(x=-1e9, y=0.0), Position(x=0.0, y=5e-324)]
    seqs = {enroll(store, str(spot), attributes=ViewAttributes(position=spot)).view.seq for spot in spots}
    assert chosen(store, Filters(near=values.near(near))) == seqs


def test_near_in_metres_is_a_circle_with_its_edge(store: SqlStore) -> None:
    spots = [(0.0, 0.0), (3.0, 4.0), (3.1, 4.0), (-5.0, 0.0), (4.0, 4.0)]
    seqs = [enroll(store, str(spot), attributes=ViewAttributes(position=Position(*spot))).view.seq for spot in spots]
    enroll(store, "nowhere")
    enroll(store, "on the globe", attributes=ViewAttributes(position=Position(lat=0.0, lon=0.0)))
    assert chosen(store, Filters(near=(0.0, 0.0, 5.0), geographic=False)) == {seqs[0], seqs[1], seqs[3]}
    assert chosen(store, Filters(near=(3.1, 4.0, 0.0), geographic=False)) == {seqs[2]}


def test_near_in_degrees_is_a_circle_on_the_globe_across_the_antimeridian_and_at_the_poles(store: SqlStore) -> None:
    draw = np.random.default_rng(5)
    spots = []
    for lat, lon in [(0, 180), (0, 0), (52, 13), (89.9, 0), (-90, 0), (-17, -179.9)]:
        for north, east in draw.normal(scale=(0.2, 3), size=(6, 2)).tolist():
            spots.append(Position(lat=min(max(lat + north, -90), 90), lon=(lon + east + 180) % 360 - 180))
    views = [
        enroll(store, str(number), attributes=ViewAttributes(position=spot)).view for number, spot in enumerate(spots)
    ]
    enroll(store, "in metres", attributes=ViewAttributes(position=Position(x=0.0, y=0.0)))
    for centre in (
        Position(lat=0.0, lon=180.0),
        Position(lat=0.0, lon=-179.99),
        Position(lat=90.0, lon=77.0),
        spots[-1],
    ):
        assert centre.lat is not None
        assert centre.lon is not None
        for radius in (0.0, 30_000.0, 200_000.0, 5_000_000.0, 30_000_000.0):
            near = {view.seq for view in views if haversine(view.attributes.position, centre) <= radius}
            assert chosen(store, Filters(near=(centre.lat, centre.lon, radius), geographic=True)) == near


def test_the_whole_globe_is_near_enough_for_its_other_side(store: SqlStore) -> None:
    view = enroll(store, "antipode", attributes=ViewAttributes(position=Position(lat=-33.3, lon=-168.7))).view
    enroll(store, "nowhere")
    half = math.pi * EARTH_RADIUS_M
    assert chosen(store, Filters(near=(33.3, 11.3, half), geographic=True)) == {view.seq}
    assert chosen(store, Filters(near=(33.3, 11.3, half - 10), geographic=True)) == set()


def test_near_in_degrees_is_exact_to_a_millimetre(store: SqlStore) -> None:
    here = Position(lat=48.137, lon=11.575)
    view = enroll(store, "gate", attributes=ViewAttributes(position=here)).view
    centre = Position(lat=48.1375, lon=11.5757)
    distance = haversine(here, centre)
    for radius, found in ((distance - 0.001, set()), (distance + 0.001, {view.seq})):
        assert chosen(store, Filters(near=(48.1375, 11.5757, radius), geographic=True)) == found


def test_after_and_before_include_their_bounds_and_leave_out_what_has_no_time(store: SqlStore) -> None:
    seqs = [enroll(store, f"{n}", attributes=ViewAttributes(captured_at=NOW + n * MINUTE)).view.seq for n in range(4)]
    enroll(store, "some time")
    assert chosen(store, Filters(after=NOW + MINUTE)) == set(seqs[1:])
    assert chosen(store, Filters(before=NOW + MINUTE)) == set(seqs[:2])
    assert chosen(store, Filters(after=NOW + MINUTE, before=NOW + 2 * MINUTE)) == set(seqs[1:3])


def test_metadata_are_compared_as_the_text_of_their_json(store: SqlStore) -> None:
    values = {"floor": 2, "name": "2", "dusk": True, "none": None, "deep": {"b": [1], "a": "é"}, "ä": "ö"}
    view = enroll(store, "gate", attributes=ViewAttributes(metadata=values)).view
    enroll(store, "pond", attributes=ViewAttributes(metadata={"floor": 20}))
    for key, text in (
        ("floor", "2"),
        ("name", "2"),
        ("dusk", "true"),
        ("none", "null"),
        ("deep", '{"a":"é","b":[1]}'),
        ("ä", "ö"),
    ):
        assert chosen(store, Filters(metadata={key: text})) == {view.seq}
    for key, text in (("floor", "2.0"), ("name", '"2"'), ("dusk", "True"), ("fl", "2"), ("deep.a", "é")):
        assert chosen(store, Filters(metadata={key: text})) == set()
    assert chosen(store, Filters(metadata={"floor": "2", "dusk": "true"})) == {view.seq}


def test_the_newest_views_are_left_out_by_number_and_by_time(store: SqlStore) -> None:
    enroll(store, "elsewhere", map="museum", now=NOW + 60 * MINUTE)
    seqs = [enroll(store, f"{n}", now=NOW + n * MINUTE).view.seq for n in range(5)]
    enroll(store, "elsewhere too", map="museum", now=NOW + 60 * MINUTE)
    assert chosen(store, Filters(exclude_last=0)) == set(seqs)
    assert chosen(store, Filters(exclude_last=2)) == set(seqs[:3])
    assert chosen(store, Filters(exclude_last=9)) == set()
    assert chosen(store, Filters(exclude_last=MINUTE)) == set(seqs[:3])
    assert chosen(store, Filters(exclude_last=timedelta(0))) == set(seqs[:4])
    assert store.listings.select("campus", Filters(exclude_last=2)).only is None


def test_nothing_is_the_newest_of_an_empty_map(store: SqlStore) -> None:
    store.maps.put("campus", RECIPE, NOW)
    for last in (3, MINUTE):
        assert chosen(store, Filters(exclude_last=last)) == set()


def test_ids_to_exclude_that_the_map_does_not_have_are_named(store: SqlStore) -> None:
    here, gone = enroll(store, "here").view, enroll(store, "gone").view
    elsewhere = enroll(store, "elsewhere", map="other").view
    store.removals.delete_view(gone.id)
    for strays in ((gone.id,), (elsewhere.id,), ("typo", gone.id)):
        with pytest.raises(InvalidParameters) as refused:
            chosen(store, Filters(exclude=(here.id, *strays)))
        (error,) = refused.value.errors
        assert error.parameter == "exclude"
        assert all(stray in error.detail for stray in strays)
        assert here.id not in error.detail
        with pytest.raises(InvalidParameters):
            store.removals.delete_views("campus", Filters(exclude=(here.id, *strays)))
    assert len(store.views.list(None, Filters(exclude=(here.id, elsewhere.id)))[0]) == 0
    with pytest.raises(InvalidParameters):
        store.views.list(None, Filters(exclude=("typo",)))


def test_filters_add_up(store: SqlStore) -> None:
    seqs, views = [], []
    for n in range(6):
        attributes = ViewAttributes(
            "gate" if n < 4 else "pond", Position(x=float(n), y=0.0), NOW + n * MINUTE, {"odd": n % 2 == 1}
        )
        views.append(enroll(store, f"{n}", attributes=attributes).view)
        seqs.append(views[-1].seq)
    assert chosen(store, Filters(place="gate", exclude=(views[0].id,))) == set(seqs[1:4])
    everything = Filters(
        near=(3.0, 0.0, 2.5), after=NOW + MINUTE, place="gate", metadata={"odd": "true"}, exclude_last=3
    )
    assert chosen(store, everything) == {seqs[1]}


def test_pages_hold_each_view_once_while_views_come_and_go(store: SqlStore) -> None:
    views = [enroll(store, f"{n}").view for n in range(7)]
    first, cursor = store.views.list("campus", Filters(), limit=3)
    assert ids(first) == ids(views[:3])
    store.removals.delete_view(views[2].id)  # the very one that the cursor stands after
    store.removals.delete_view(views[4].id)
    late = enroll(store, "late").view
    second, cursor = store.views.list("campus", Filters(), limit=3, cursor=cursor)
    third, end = store.views.list("campus", Filters(), limit=3, cursor=cursor)
    assert ids([*second, *third]) == ids([views[3], views[5], views[6], late])
    assert end is None

    newest, cursor = store.views.list("campus", Filters(), newest_first=True, limit=2)
    assert ids(newest) == [late.id, views[6].id]
    enroll(store, "later still")
    older, _ = store.views.list("campus", Filters(), newest_first=True, limit=2, cursor=cursor)
    assert ids(older) == [views[5].id, views[3].id]


def test_a_page_that_is_just_full_is_the_last(store: SqlStore) -> None:
    enroll(store, "gate")
    enroll(store, "pond", map="museum")
    assert store.views.list("campus", Filters(), limit=1)[1] is None
    views, end = store.views.list(None, Filters(), limit=2)
    assert ([view.map for view in views], end) == (["campus", "museum"], None)
    assert store.views.list(None, Filters(), state="ready") == ([], None)


@pytest.mark.parametrize(
    "cursor",
    [
        *("", "moon", "é", "W10", "bnVsbA", "MQ", "WyJvbGRlc3QiLCAidGV4dCJd"),
        *(cursor_after("oldest", number) for number in (2**63, -(2**64), 10**300)),
        *(cursor_after("places", "campus", text) for text in ("a\0", "\ud800")),
    ],
)
def test_a_cursor_that_is_none_of_ours_is_refused(store: SqlStore, cursor: str) -> None:
    enroll(store, "gate")
    with pytest.raises(InvalidParameters, match="cursor"):
        store.views.list("campus", Filters(), cursor=cursor)
    with pytest.raises(InvalidParameters, match="cursor"):
        store.listings.places("campus", cursor, 5)


def test_a_cursor_is_good_for_its_own_order_only(store: SqlStore) -> None:
    for n in range(3):
        enroll(store, f"{n}")
    _, cursor = store.views.list("campus", Filters(), limit=1)
    with pytest.raises(InvalidParameters, match="cursor"):
        store.views.list("campus", Filters(), cursor=cursor, newest_first=True)


def test_a_place_lies_in_the_middle_of_its_views(store: SqlStore) -> None:
    for number, (place, position) in enumerate(
        [
            ("date line", Position(lat=10.0, lon=179.0, alt=2.0)),
            ("date line", Position(lat=10.0, lon=-179.0, alt=4.0)),
            ("gate", Position(x=1.0, y=2.0, z=3.0)),
            ("gate", Position(x=3.0, y=2.0, z=3.0, heading=4.0)),
            ("gate", Position()),
            ("unseen", Position()),
        ]
    ):
        enroll(store, f"{number}", attributes=ViewAttributes(place, position), now=NOW + number * MINUTE)
    enroll(store, "no place")

    (line, gate, unseen), end = store.listings.places("campus", None, 10)

    assert end is None
    assert (line[:3], gate[:3], unseen[:3]) == (
        ("campus", "date line", 2),
        ("campus", "gate", 3),
        ("campus", "unseen", 1),
    )
    assert gate[3] == Position(x=2.0, y=2.0, z=3.0)
    assert line[3].lat == pytest.approx(10, abs=0.01)
    assert abs(line[3].lon or 0) == pytest.approx(180)
    assert line[3].alt == 3
    assert unseen[3] == Position()
    assert gate[4] == NOW + 4 * MINUTE


@pytest.mark.parametrize(
    ("longitudes", "box"),
    [
        ((179.9999, -179.9999), (179.9999, -179.9999)),
        ((180.0, -180.0), (180.0, -180.0)),
        ((100.0, 170.0, -100.0), (100.0, -100.0)),
        ((-10.0, 0.0, 20.0), (-10.0, 20.0)),
        ((-70.0, -10.0), (-70.0, -10.0)),
        ((-90.0, 90.0), (-90.0, 90.0)),
    ],
)
def test_the_box_of_a_map_is_the_narrower_one_around_the_globe(
    store: SqlStore, longitudes: tuple[float, ...], box: tuple[float, float]
) -> None:
    for number, lon in enumerate(longitudes):
        enroll(store, f"{number}", attributes=ViewAttributes(None, Position(lat=-17.0, lon=lon)))
    counts = store.maps.counts("campus")
    assert (counts.lowest, counts.highest) == (Position(lat=-17.0, lon=box[0]), Position(lat=-17.0, lon=box[1]))


def test_places_are_paged_by_map_and_name(store: SqlStore) -> None:
    for map_name in ("a", "b"):
        for place in ("B", "a", "b"):
            enroll(store, f"{map_name} {place}", map=map_name, attributes=ViewAttributes(place))
    seen: list[tuple[str, str]] = []
    cursor = None
    while True:
        page, cursor = store.listings.places(None, cursor, 2)
        seen += [(entry[0], entry[1]) for entry in page]
        if cursor is None:
            break
    assert seen == [(map_name, place) for map_name in ("a", "b") for place in ("B", "a", "b")]
