"""What a store promises about maps, enrolment, work and views, on every adapter."""

import hashlib
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from schemas.enrolment import EnrolmentOptions
from schemas.errors import Conflict, KeyReused, LeaseLost, NotFound
from schemas.records import Filters, Position, Replay, ViewAttributes
from tests.storage.conftest import Open
from tests.storage.material import (
    NOW,
    RECIPE,
    Follower,
    describe_all,
    description,
    enroll,
    facts,
    finish,
    image,
    recipe,
    seed,
    vector,
)
from worker.storage.store import SqlStore

# maps


def test_a_new_store_is_empty_and_well(store: SqlStore) -> None:
    assert store.check() == "ok"
    assert store.maps.all() == []


def test_the_first_image_makes_its_map(store: SqlStore) -> None:
    enroll(store, "gate")
    assert store.maps.get("campus").recipe == RECIPE
    assert store.maps.get("campus").created_at == NOW
    assert [record.name for record in store.maps.all()] == ["campus"]


def test_maps_are_listed_by_name_as_computers_sort(store: SqlStore) -> None:
    for name in ("b", "a", "B", "a-1"):
        store.maps.put(name, RECIPE, NOW)
    assert [record.name for record in store.maps.all()] == ["B", "a", "a-1", "b"]


def test_an_empty_map_takes_another_recipe_and_one_with_views_refuses(store: SqlStore) -> None:
    assert store.maps.put("campus", RECIPE, NOW)[1] is True
    record, new = store.maps.put("campus", recipe("paper"), NOW)
    assert (record.ranking.preset, new) == ("paper", False)
    enroll(store, "gate")
    assert store.maps.put("campus", recipe("paper"), NOW)[1] is False
    with pytest.raises(Conflict, match="POST /maps/campus/recipe"):
        store.maps.put("campus", RECIPE, NOW)


def test_what_is_not_there_is_said_to_be_not_there(store: SqlStore) -> None:
    nothing = Filters()
    for ask in (
        lambda: store.maps.get("moon"),
        lambda: store.maps.counts("moon"),
        lambda: store.maps.revision("moon"),
        lambda: store.descriptions.since("moon", 0),
        lambda: store.listings.select("moon", nothing),
        lambda: store.views.list("moon", nothing),
        lambda: store.listings.places("moon", None, 5),
        lambda: store.removals.delete_map("moon"),
        lambda: store.removals.delete_views("moon", nothing),
        lambda: store.jobs.switch_recipe("moon", RECIPE, NOW),
        lambda: store.views.get("moon"),
        lambda: store.views.change("moon", lambda _: ViewAttributes()),
        lambda: store.removals.delete_view("moon"),
        lambda: store.views.image("moon"),
        lambda: store.jobs.get("moon"),
        lambda: store.jobs.cancel("moon", NOW),
        lambda: store.vocabularies.get("moon"),
    ):
        with pytest.raises(NotFound, match="moon"):
            ask()


def test_counts_are_those_of_the_views(store: SqlStore) -> None:
    assert store.maps.put("campus", RECIPE, NOW)[1]
    assert store.maps.counts("campus").lowest == Position()
    enroll(store, "gate", attributes=ViewAttributes("gate", Position(x=1.0, y=5.0)))
    enroll(store, "gate at dusk", attributes=ViewAttributes("gate", Position(x=-1.0, y=7.0, heading=90.0)))
    enroll(store, "pond", attributes=ViewAttributes("pond"))
    [first, _, last] = store.jobs.claim("worker", 3)
    finish(store, first)
    store.jobs.fail(last, "nothing-static", "all is water", NOW)

    counts = store.maps.counts("campus")

    assert counts.views == {"pending": 1, "ready": 1, "failed": 1}
    assert counts.places == 2
    assert counts.image_bytes == sum(len(image(name)) for name in ("gate", "gate at dusk", "pond"))
    assert (counts.lowest, counts.highest) == (Position(x=-1.0, y=5.0), Position(x=1.0, y=7.0))


def test_a_map_made_anew_under_an_old_name_has_nothing_of_the_old_one(store: SqlStore) -> None:
    enroll(store, "gate")
    describe_all(store)
    old = Follower(store).catch_up()
    removal = store.removals.delete_map("campus")
    assert (removal.views, removal.images, removal.revision) == (1, 1, None)
    enroll(store, "pond")
    assert store.maps.revision("campus") > old.revision
    assert store.descriptions.since("campus", old.revision).seqs.tolist() == []
    describe_all(store)
    assert len(store.descriptions.since("campus", old.revision).seqs) == 1


# enrolment


def test_what_was_enrolled_is_there_after_a_restart_byte_for_byte(reopen: Open) -> None:
    store = reopen()
    attributes = ViewAttributes(
        "gate", Position(lat=48.1, lon=11.5, alt=500.0, heading=0.0), NOW, {"floor": 2, "tags": ["north", None]}
    )
    submitted = enroll(store, "gate", attributes=attributes)
    store.close()

    view = reopen().views.get(submitted.view.id)

    assert view == submitted.view
    assert view.attributes == attributes
    assert (view.state, view.failure, view.description) == ("pending", None, None)
    assert reopen().views.image(view.id) == image("gate")


def test_a_view_is_searchable_from_the_revision_its_description_gave(store: SqlStore) -> None:
    submitted = enroll(store, "gate")
    [claim] = store.jobs.claim("worker", 5)
    assert claim.view == submitted.view
    before = store.maps.revision("campus")

    revision = finish(store, claim)

    assert revision == store.maps.revision("campus") > before
    view = store.views.get(submitted.view.id)
    assert view.state == "ready"
    assert view.description is not None
    assert view.description.recipe == RECIPE.description.id
    assert (view.description.descriptor_count, view.description.static_share, view.description.nodes) == (120, 0.75, 2)
    assert view.description.label_shares.tolist() == [0.75, 0.25]
    assert store.descriptions.since("campus", before).seqs.tolist() == [view.seq]
    assert len(store.descriptions.since("campus", revision).seqs) == 0
    assert submitted.job_id is not None
    assert store.jobs.get(submitted.job_id).state == "done"


def test_a_description_comes_back_as_it_was_given(store: SqlStore) -> None:
    enroll(store, "gate")
    [claim] = store.jobs.claim("worker", 1)
    given = description(seed(claim.view, RECIPE.description.id))
    store.jobs.finish(claim, given, NOW)
    seqs = cast("list[int]", list(np.array([claim.view.seq, 999])))  # as an index hands them over

    [appearance] = store.descriptions.appearances(seqs, RECIPE.description.id).values()
    [cells] = store.descriptions.cells(seqs, RECIPE.description.id).values()
    [features] = store.descriptions.local_features(seqs, RECIPE.description.id).values()

    assert store.descriptions.since("campus", 0).vectors.tolist() == [vector(claim.view, RECIPE.description.id)]
    np.testing.assert_array_equal(appearance.coarse, given.appearance.coarse, strict=True)
    assert appearance.extent == given.appearance.extent
    np.testing.assert_array_equal(cells, given.cells, strict=True)
    for field in ("labels", "positions", "embeddings", "shares"):
        np.testing.assert_array_equal(
            getattr(appearance.graph, field), getattr(given.appearance.graph, field), strict=True
        )
    assert given.keypoints is not None
    np.testing.assert_array_equal(features.positions, given.keypoints.positions, strict=True)
    np.testing.assert_array_equal(features.descriptors, given.keypoints.descriptors, strict=True)
    assert list(store.views.at(seqs)) == [claim.view.seq]
    assert (
        store.descriptions.appearances(seqs, recipe("paper").description.id)
        == store.descriptions.cells(seqs, recipe("paper").description.id)
        == {}
    )


def test_a_recipe_without_verification_has_no_keypoints(store: SqlStore) -> None:
    enroll(store, "gate")
    [claim] = store.jobs.claim("worker", 1)
    store.jobs.finish(claim, replace(description(1), keypoints=None), NOW)
    assert store.descriptions.local_features([claim.view.seq], RECIPE.description.id) == {}


def test_the_same_image_twice_is_the_view_that_is_there(store: SqlStore) -> None:
    attributes = ViewAttributes("gate", Position(x=1.0, y=2.0), metadata={"floor": 2, "dusk": True})
    first = enroll(store, "gate", attributes=attributes)
    for again in (ViewAttributes(), ViewAttributes("gate"), ViewAttributes(metadata={"floor": 2}), attributes):
        second = enroll(store, "gate", attributes=again)
        assert (second.created, second.view, second.job_id) == (False, first.view, first.job_id)
    describe_all(store)
    assert enroll(store, "gate").job_id is None
    assert store.maps.counts("campus").views == {"pending": 0, "ready": 1, "failed": 0}


def test_the_same_image_with_something_else_said_is_a_conflict_that_names_it(store: SqlStore) -> None:
    enroll(store, "gate", attributes=ViewAttributes("gate", Position(x=1.0, y=2.0), metadata={"floor": 1}))
    anew = ViewAttributes("gate", Position(x=1.0, y=3.0), NOW, {"floor": True})
    with pytest.raises(Conflict, match=r"another y, captured_at, metadata\.floor; PATCH"):
        enroll(store, "gate", attributes=anew)


def test_a_failed_image_that_is_sent_again_is_tried_again(store: SqlStore) -> None:
    first = enroll(store, "gate")
    [claim] = store.jobs.claim("worker", 1)
    store.jobs.fail(claim, "nothing-static", "a bus in front", NOW)
    assert store.views.get(first.view.id).failure == ("nothing-static", "a bus in front")

    again = enroll(store, "gate")

    assert (again.created, again.view.id, again.view.state, again.view.failure) == (
        False,
        first.view.id,
        "pending",
        None,
    )
    assert again.job_id != first.job_id
    assert describe_all(store) == 1
    assert store.views.get(first.view.id).state == "ready"


def test_numbers_of_numpy_are_kept_as_numbers(store: SqlStore) -> None:
    position = Position(x=np.float32(0.5), y=np.float64(2))  # type: ignore[arg-type]
    view = enroll(store, "gate", attributes=ViewAttributes(position=position)).view
    assert store.views.get(view.id).attributes.position == Position(x=0.5, y=2.0)
    assert store.listings.select("campus", Filters(near=(0.5, 2.0, 0.0))).only.tolist() == [view.seq]  # type: ignore[union-attr]


def test_times_are_moments_whatever_their_zone(store: SqlStore) -> None:
    tokyo = timezone(timedelta(hours=9))
    view = enroll(store, "gate", attributes=ViewAttributes(captured_at=datetime(2026, 3, 1, 9, tzinfo=tokyo))).view
    captured = store.views.get(view.id).attributes.captured_at
    assert captured == datetime(2026, 3, 1, 0, tzinfo=UTC)
    assert captured.tzinfo is UTC
    with pytest.raises(Exception, match="a time needs a zone"):
        enroll(store, "pond", attributes=ViewAttributes(captured_at=datetime(2026, 3, 1)))


# views


def test_a_correction_replaces_all_that_was_said(store: SqlStore) -> None:
    view = enroll(store, "gate", attributes=ViewAttributes("gate", Position(x=1.0, y=2.0), NOW, {"floor": 1})).view
    describe_all(store)
    before = store.maps.revision("campus")

    corrected = store.views.change(view.id, lambda _: ViewAttributes("door", metadata={"floor": 2}))

    assert corrected.attributes == ViewAttributes("door", metadata={"floor": 2})
    assert store.views.get(view.id).attributes == corrected.attributes
    assert store.maps.revision("campus") > before
    for floor, found in (("1", []), ("2", [view.seq])):
        only = store.listings.select("campus", Filters(metadata={"floor": floor})).only
        assert only is not None
        assert only.tolist() == found
    assert Follower(store).catch_up().vectors.keys() == {view.seq}


def test_a_correction_that_changes_nothing_gives_no_revision(store: SqlStore) -> None:
    attributes = ViewAttributes("gate", Position(x=1.0, y=2.0), NOW, {"b": 1, "a": [1, 2]})
    view = enroll(store, "gate", attributes=attributes).view
    before = store.maps.revision("campus")
    assert store.views.change(view.id, lambda _: attributes) == view
    assert store.maps.revision("campus") == before


def test_a_deleted_view_is_gone_from_table_index_and_folder(store: SqlStore, data: Path) -> None:
    view = enroll(store, "gate").view
    enroll(store, "pond")
    describe_all(store)
    follower = Follower(store).catch_up()

    removal = store.removals.delete_view(view.id)

    assert (removal.views, removal.images, removal.revision) == (1, 1, store.maps.revision("campus"))
    assert follower.catch_up().vectors.keys() == Follower(store).catch_up().vectors.keys()
    assert view.seq not in follower.vectors
    assert store.views.at([view.seq]) == {}
    assert store.descriptions.appearances([view.seq], RECIPE.description.id) == {}
    assert store.descriptions.cells([view.seq], RECIPE.description.id) == {}
    assert not list((data / "pictures").rglob(view.image.sha256))
    assert enroll(store, "gate").view.seq > view.seq + 1


def test_an_image_stays_while_a_view_of_another_map_shows_it(store: SqlStore) -> None:
    here = enroll(store, "gate", map="campus").view
    there = enroll(store, "gate", map="museum").view
    assert store.removals.delete_view(here.id).images == 0
    assert store.views.image(there.id) == image("gate")
    assert store.removals.delete_map("museum").images == 1


def test_views_are_deleted_by_filter(store: SqlStore) -> None:
    for number in range(6):
        enroll(store, f"{number}", attributes=ViewAttributes("gate" if number % 2 else "pond"))
    before = store.maps.revision("campus")
    removal = store.removals.delete_views("campus", Filters(place="gate", exclude_last=1))
    assert (removal.views, removal.images) == (2, 2)
    views, _ = store.views.list("campus", Filters())
    assert [view.attributes.place for view in views] == ["pond", "pond", "pond", "gate"]
    assert removal.revision == store.maps.revision("campus") > before
    assert store.removals.delete_views("campus", Filters(place="moon")).revision == removal.revision


def test_many_views_are_deleted_in_portions_that_let_others_write(
    store: SqlStore, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("worker.storage.removals.PORTION", 2)
    for number in range(5):
        enroll(store, f"{number}")
    describe_all(store)
    follower = Follower(store).catch_up()
    assert store.removals.delete_views("campus", Filters(exclude_last=1)).views == 4
    assert len(follower.catch_up().vectors) == 1


def test_a_deletion_of_a_map_that_a_crash_cut_short_is_finished_by_recovery(
    store: SqlStore, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    views = [enroll(store, f"{number}", attributes=ViewAttributes("gate")).view for number in range(3)]
    [claim, *_] = store.jobs.claim("worker", 1)

    def cut(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("worker.storage.removals.Removals.clear", cut)
        with pytest.raises(KeyboardInterrupt):
            store.removals.delete_map("campus")

    assert store.maps.all() == []
    assert store.views.list(None, Filters()) == ([], None)
    assert store.listings.places(None, None, 5) == ([], None)
    assert store.jobs.claim("worker", 5) == []
    for ask in (store.views.get, store.views.image, store.removals.delete_view):
        with pytest.raises(NotFound):
            ask(views[0].id)
    with pytest.raises(LeaseLost):
        finish(store, claim)
    anew = enroll(store, "0").view
    store.recover()
    assert [path.name for path in (data / "pictures").glob("??/??/*")] == [anew.image.sha256]
    assert store.views.image(anew.id) == image("0")


# repeated calls, vocabularies, care


def test_a_finished_call_is_repeated_for_a_day(store: SqlStore) -> None:
    replay = Replay(201, {"Location": "/views/1"}, b'{"view": 1}')
    assert store.calls.begin("key", "fingerprint", NOW) is None
    with pytest.raises(Conflict):
        store.calls.begin("key", "fingerprint", NOW)
    store.calls.end("key", replay, NOW)
    assert store.calls.begin("key", "fingerprint", NOW + timedelta(hours=23)) == replay
    with pytest.raises(KeyReused):
        store.calls.begin("key", "another", NOW)
    assert store.calls.begin("key", "another", NOW + timedelta(hours=24)) is None


def test_a_call_that_failed_can_be_tried_again(store: SqlStore) -> None:
    store.calls.begin("key", "fingerprint", NOW)
    store.calls.abandon("key")
    assert store.calls.begin("key", "another", NOW) is None


def test_a_call_that_a_crash_cut_short_can_be_made_again(reopen: Open) -> None:
    store = reopen()
    store.calls.begin("finished", "fingerprint", NOW)
    store.calls.end("finished", Replay(200, {}, b""), NOW)
    store.calls.begin("cut short", "fingerprint", NOW)
    store.close()
    store = reopen()
    store.recover()
    assert store.calls.begin("cut short", "fingerprint", NOW) is None
    assert store.calls.begin("finished", "fingerprint", NOW) == Replay(200, {}, b"")


def test_a_vocabulary_is_kept_under_its_digest(store: SqlStore) -> None:
    digest = hashlib.sha256(b"tensors").hexdigest()
    for _ in range(2):
        store.vocabularies.keep(digest, b"tensors")
    assert store.vocabularies.get(digest) == b"tensors"


def test_an_image_of_wrong_digest_is_refused(store: SqlStore) -> None:
    with pytest.raises(ValueError, match="SHA-256"):
        store.enrolment.submit("campus", b"one", facts(b"another"), ViewAttributes(), EnrolmentOptions(NOW, RECIPE))
    assert store.maps.all() == []
