"""Views are excluded by the order and the time of their enrolment, whatever the clock of the machine does."""

from collections.abc import Mapping
from datetime import timedelta
from itertools import accumulate, pairwise
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from schemas.enrolment import EnrolmentOptions
from schemas.records import Filters, ViewAttributes
from tests.storage.carried import made, views
from tests.storage.conftest import Open
from tests.storage.databases import data_folder, sqlite_url
from tests.storage.material import NOW, RECIPE, enroll, facts, image
from worker.storage.enrolment_order import following_id
from worker.storage.store import SqlStore, open_store

SECONDS = st.integers(-(10**9), 10**9)


def searched(store: SqlStore, seconds: float, map_name: str = "campus") -> list[str]:
    """Ids of the views of a map that are not among those of its last seconds, in enrolment order."""
    found, _ = store.views.list(map_name, Filters(exclude_last=timedelta(seconds=seconds)), limit=1000)
    return [view.id for view in found]


def at(store: SqlStore, number: int, wall_s: float, steady_s: float | None = None, map_name: str = "campus") -> str:
    """Enrol a view at a time of the machine's clock and a reading of the steady one; its id."""
    body = image(f"{number}")
    now = NOW + timedelta(seconds=wall_s)
    options = EnrolmentOptions(now, RECIPE, steady_s)
    return store.enrolment.submit(map_name, body, facts(body), ViewAttributes(), options).view.id


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(jumps=st.lists(SECONDS, min_size=1, max_size=12), span=st.integers(0, 10**9))
def test_time_is_what_passed_between_enrolments_and_a_jump_back_counts_nothing(jumps: list[int], span: int) -> None:
    """Without a steady clock, as between two runs of the service."""
    times = list(accumulate(jumps))
    with data_folder() as folder:
        store = open_store(sqlite_url(folder), folder)
        ids = [at(store, number, time) for number, time in enumerate(times)]
        passed = [max(0, later - earlier) for earlier, later in pairwise(times)]
        wanted = [view for number, view in enumerate(ids) if sum(passed[number:]) > span]
        assert searched(store, span) == wanted
        assert ids == sorted(ids)
        store.close()


@settings(max_examples=40, deadline=None)
@given(
    steps=st.lists(st.tuples(SECONDS, st.integers(0, 100)), min_size=2, max_size=12),
    span=st.integers(0, 300),
)
def test_within_a_run_only_the_steady_clock_counts(steps: list[tuple[int, int]], span: int) -> None:
    """A clock set forward by years excludes and admits the same views as one that is right."""
    with data_folder() as folder:
        store = open_store(sqlite_url(folder), folder)
        steady = list(accumulate(step for _, step in steps))
        ids = [at(store, number, wall, steady[number]) for number, (wall, _) in enumerate(steps)]
        assert searched(store, span) == [
            view for view, moment in zip(ids, steady, strict=True) if steady[-1] - moment > span
        ]
        assert ids == sorted(ids)
        store.close()


def test_enrolments_of_other_maps_and_deletions_do_not_stop_the_time(store: SqlStore) -> None:
    old = at(store, 0, 0, 100.0)
    other = at(store, 1, -5000, 120.0, "elsewhere")
    store.removals.delete_view(other)
    new = at(store, 2, 9000, 140.0)
    assert searched(store, 39) == [old]
    assert searched(store, 40) == []
    assert searched(store, 0) == [old]
    store.removals.delete_view(new)
    assert searched(store, 0) == []


def test_after_a_restart_the_time_goes_on_from_the_newest_view(reopen: Open) -> None:
    first = at(reopen(), 0, 0, 1000.0)
    again = reopen()  # its steady clock begins anew, the machine's clock went on by a minute
    at(again, 1, 60, 5.0)
    at(again, 2, -(10**6), 6.0)
    assert searched(again, 60) == [first]
    assert searched(again, 61) == []


@pytest.mark.parametrize("ahead_s", [-3600, -1, 1, 3600])
def test_services_whose_clocks_differ_enrol_in_turn_and_count_what_passed(reopen: Open, ahead_s: int) -> None:
    right, wrong = reopen(), reopen()
    before = at(right, 100, -10, 4990.0)
    ids = []
    for second in range(20):
        if second % 2:
            ids.append(at(wrong, second, second + ahead_s, 700.0 + second))
        else:
            ids.append(at(right, second, second, 5000.0 + second))
    # What it thinks of the second before its first enrolment is all that a wrong clock changes.
    assert searched(right, 6) in [[before, *ids[:first]] for first in (12, 13, 14)]
    assert searched(right, 11) in [[before, *ids[:first]] for first in (7, 8, 9)]


DAY_S = 24 * 3600
OLD_S = 30 * DAY_S


@pytest.fixture
def old(elsewhere: SqlStore) -> Path:
    """The snapshot of the map ``old`` of another service: two views a month ago, and a day later two more."""
    for number, second in enumerate([0, 10, DAY_S, DAY_S + 10]):
        at(elsewhere, number, second - OLD_S, 7e6 + second, "old")
    return made(elsewhere, "old")


@pytest.mark.parametrize("steady_s", [1000.0, None], ids=["a steady clock", "none"])
def test_what_was_enrolled_a_moment_ago_stays_so_when_an_old_map_is_restored(
    store: SqlStore, old: Path, steady_s: float | None
) -> None:
    """A robot that drives meanwhile would otherwise take what it sees for a place that it came back to."""

    def drive(second: int) -> str:
        return at(store, 100 + second, second, None if steady_s is None else steady_s + second)

    ids = [drive(second) for second in range(5)]
    for name in ("old", "its copy"):  # of the second one the views get new ids
        store.restoring.restore(old, name, NOW)
        ids.append(drive(len(ids)))
    assert searched(store, 30) == []
    assert searched(store, 3) == ids[:3]


def test_a_service_that_enrols_after_a_restoration_by_another_counts_what_passed(reopen: Open, old: Path) -> None:
    one, started_before = reopen(), reopen()
    ids = [at(one, 100, 0, 1000.0), at(started_before, 101, 1, 50.0)]
    one.restoring.restore(old, None, NOW)
    started_after = reopen()
    ids += [at(started_after, 102, 2, 5.0), at(started_before, 103, 3, 52.0), at(one, 104, 4, 1004.0)]
    for store in (one, started_before, started_after):
        assert searched(store, 10) == []
        assert searched(store, 2) == ids[:2]


def test_a_view_enrolled_while_a_map_is_restored_follows_those_of_its_own_map(
    reopen: Open, old: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a service whose clock was ahead enrolled before, which rows of the restored map then hide."""
    right, ahead = reopen(), reopen()
    at(right, 100, 0, 1000.0)
    ids = [at(ahead, 101, 3600, 5.0)]
    add = right._images.add

    def meanwhile(images: Mapping[str, bytes]) -> None:
        add(images)
        if len(ids) == 1:
            ids.append(at(right, 102, 1, 1001.0))

    monkeypatch.setattr(right._images, "add", meanwhile)
    right.restoring.restore(old, None, NOW)
    assert len(ids) == 2
    assert ids[-1] not in searched(right, 0)


def test_a_restored_map_keeps_the_times_between_its_views(store: SqlStore, elsewhere: SqlStore, old: Path) -> None:
    """Although this service has counted seconds only; also when it is carried on from here."""
    for second in range(3):
        at(store, 100 + second, second, 1000.0 + second)
    store.restoring.restore(old, None, NOW)
    elsewhere.restoring.restore(made(store, "old"), "returned", NOW)
    for service, name in ((store, "old"), (elsewhere, "returned")):
        ids = [view.id for view in views(service, name)]
        assert searched(service, DAY_S + 10, name) == []
        assert searched(service, DAY_S, name) == ids[:1]
        assert searched(service, 30, name) == ids[:2]
        assert searched(service, 9, name) == ids[:3]
    later = at(store, 200, 20, 1020.0, "old")
    assert searched(store, 30, "old") == [view.id for view in views(store, "old")][:2]
    assert searched(store, 0, "old") == [view.id for view in views(store, "old") if view.id != later]


def test_a_map_restored_where_nothing_was_enrolled_is_as_old_as_it_is(store: SqlStore, old: Path) -> None:
    store.restoring.restore(old, None, NOW)
    before = [view.id for view in views(store, "old")]
    at(store, 200, 0, 5.0, "old")
    assert searched(store, 20 * DAY_S, "old") == before
    assert searched(store, 31 * DAY_S, "old") == []


def test_pages_and_ids_keep_the_order_of_enrolment_when_the_clock_goes_back(store: SqlStore) -> None:
    ids = [enroll(store, f"{number}", now=NOW - timedelta(days=number)).view.id for number in range(9)]
    listed: list[str] = []
    cursor = None
    while True:
        page, cursor = store.views.list("campus", Filters(), cursor=cursor, limit=2)
        listed += [view.id for view in page]
        if cursor is None:
            break
    assert listed == ids == sorted(ids)


@given(st.integers(0, 2**48 - 2), st.integers(0, 2**74 - 1))
def test_an_id_follows_any_other(milliseconds: int, rest: int) -> None:
    from uuid6 import UUID

    previous = str(UUID(int=(milliseconds << 80) | rest, version=7))
    made = following_id(previous)
    assert made > previous
    assert UUID(made).version == 7
