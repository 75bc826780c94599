"""What is promised of images holds wherever they lie: in a folder, or in an S3-compatible store."""

import shutil
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path
from threading import Event, Thread
from typing import NoReturn

import pytest

from schemas.errors import Conflict, Damaged, DiskFull, NotFound, RevisitError, StorageFailed
from schemas.records import Filters, ViewAttributes
from tests.storage.conftest import Place
from tests.storage.databases import postgres_schema, put_tables, sqlite_url
from tests.storage.material import NOW, describe_all, enroll, facts, image
from tests.storage.object_store import ADDRESS, ObjectStore, aws, refusing, server
from tests.waiting import until
from worker.storage.examining import examine
from worker.storage.repairing import repair
from worker.storage.signs import ALIVE
from worker.storage.store import open_store

Put = Callable[[str, bytes | None], None]


def test_an_image_lies_under_its_digest_and_is_read_back(place: Place) -> None:
    view = enroll(place.store, "gate").view
    assert place.digests() == [view.image.sha256]
    assert place.store.views.image(view.id) == image("gate")


def test_a_row_that_fails_takes_its_image_with_it(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> NoReturn:
        raise RuntimeError

    monkeypatch.setattr("worker.storage.enrolment.keep_pairs", fail)
    with pytest.raises(RuntimeError):
        enroll(place.store, "gate")
    assert place.digests() == []


def test_an_image_of_another_digest_is_refused(place: Place) -> None:
    with pytest.raises(ValueError, match="is not the SHA-256"), place.store._images.kept("0" * 64, b"other"):
        pass
    assert place.digests() == []


def test_an_image_that_a_crash_left_without_a_row_is_swept(place: Place) -> None:
    kept = enroll(place.store, "pond").view
    place.put(facts(image("gate")).sha256, image("gate"))
    assert place.store._images.sweep() == 1
    assert place.digests() == [kept.image.sha256]


def test_the_start_begins_a_sweep(place: Place) -> None:
    kept = enroll(place.store, "pond").view
    place.put(facts(image("gate")).sha256, image("gate"))
    place.store.recover()
    until(lambda: place.digests() == [kept.image.sha256])


def test_so_does_that_of_a_service_beside_others(place: Place) -> None:
    """It may have been killed amid a deletion, and in a fleet there is always another."""
    kept = enroll(place.store, "pond").view
    place.store.recover()
    place.put(facts(image("gate")).sha256, image("gate"))
    with closing(place.open()) as again:
        again.recover()
        until(lambda: place.digests() == [kept.image.sha256])


def test_a_damaged_a_lost_and_an_empty_image_are_named_and_healed_by_enrolling_again(place: Place) -> None:
    view = enroll(place.store, "gate").view
    for content, says in ((b"other", "does not hold what was enrolled"), (b"", "is empty"), (None, "is missing")):
        place.put(view.image.sha256, content)
        with pytest.raises(Damaged, match=says):
            place.store.views.image(view.id)
        enroll(place.store, "gate")
        assert place.store.views.image(view.id) == image("gate")


def test_images_go_with_the_last_view_that_needs_them(place: Place) -> None:
    here, there = enroll(place.store, "gate").view, enroll(place.store, "gate", map="museum").view
    assert place.store.removals.delete_view(here.id).images == 0
    assert place.store.views.image(there.id) == image("gate")
    assert place.store.removals.delete_map("museum").images == 1
    assert place.digests() == []
    with pytest.raises(NotFound):
        place.store.views.image(there.id)


def test_a_conflict_leaves_the_image_of_the_view_that_is_there(place: Place) -> None:
    view = enroll(place.store, "gate", attributes=ViewAttributes("gate")).view
    with pytest.raises(Conflict):
        enroll(place.store, "gate", attributes=ViewAttributes("pond"))
    assert place.store.views.image(view.id) == image("gate")


def test_an_image_enrolled_while_others_sweep_and_delete_it_is_never_taken_away(place: Place) -> None:
    stop = False

    def sweep() -> None:
        while not stop:
            place.store._images.sweep()

    def come_and_go() -> None:
        while not stop:
            place.store.removals.delete_view(enroll(place.store, "gate", map="museum").view.id)

    others = [Thread(target=sweep), Thread(target=come_and_go)]
    for other in others:
        other.start()
    try:
        for _ in range(10):
            view = enroll(place.store, "gate").view
            assert place.store.views.image(view.id) == image("gate")
            assert place.store.removals.delete_view(view.id).views == 1
    finally:
        stop = True
        for other in others:
            other.join()
    assert place.digests() == []


def test_a_snapshot_carries_images_from_and_to_the_place(place: Place) -> None:
    for name in ("gate", "pond"):
        enroll(place.store, name)
    describe_all(place.store)
    job = "0" * 8 + "-0000-7000-8000-" + "0" * 12
    place.store.snapshots.make("campus", job, NOW, lambda *_: None)
    place.store.removals.delete_map("campus")
    assert place.digests() == []

    copied = place.data / "copied"
    with place.store.snapshots.open(job) as file:
        copied.write_bytes(file.read())
    place.store.restoring.restore(copied, "again", NOW)

    views, _ = place.store.views.list("again", Filters())
    assert {place.store.views.image(view.id) for view in views} == {image("gate"), image("pond")}


def test_a_map_is_restored_whole_while_images_of_its_last_deletion_are_still_removed(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever removes them saw that no view needs them; those of the restored map came after that."""
    enroll(place.store, "gate")
    describe_all(place.store)
    job = "0" * 8 + "-0000-7000-8000-" + "0" * 12
    place.store.snapshots.make("campus", job, NOW, lambda *_: None)
    copied = place.data / "copied"
    with place.store.snapshots.open(job) as file:
        copied.write_bytes(file.read())
    images = place.store._images
    owned, add = images._owned, images.add  # type: ignore[attr-defined]
    looked, added = Event(), Event()

    def slow(digests: list[str]) -> set[str]:
        needed: set[str] = owned(digests)
        looked.set()
        added.wait(1)
        return needed

    def adding(bodies: Mapping[str, bytes]) -> None:
        add(bodies)
        added.set()

    monkeypatch.setattr(images, "_owned", slow)
    monkeypatch.setattr(images, "add", adding)
    deletion = Thread(target=place.store.removals.delete_map, args=["campus"])
    deletion.start()
    assert looked.wait(60)
    place.store.restoring.restore(copied, "again", NOW)
    deletion.join()

    [view] = place.store.views.list("again", Filters())[0]
    assert place.store.views.image(view.id) == image("gate")


def test_doctor_names_each_fault_and_repair_removes_orphans(place: Place) -> None:
    damaged, lost = enroll(place.store, "gate").view, enroll(place.store, "pond").view
    describe_all(place.store)
    place.put(damaged.image.sha256, b"other")
    place.put(lost.image.sha256, None)
    orphan = facts(image("orphan")).sha256
    place.put(orphan, image("orphan"))
    place.store.close()

    found = {
        finding.where.rpartition("/")[2]: finding.what
        for finding in examine(place.url, place.data, images=place.address)
    }
    assert "does not hold what was enrolled" in found[damaged.image.sha256]
    assert "is missing" in found[lost.image.sha256]
    assert found[orphan] == "belongs to no view"

    repair(place.url, place.data, place.address)
    assert place.digests() == [damaged.image.sha256]


@pytest.mark.parametrize(
    ("status", "code", "kind", "says"),
    [
        (403, "AccessDenied", StorageFailed, "refuses access"),
        (404, "NoSuchBucket", StorageFailed, "no such bucket"),
        (507, "XMinioStorageFull", DiskFull, "is full"),
        (400, "MalformedThing", StorageFailed, "cannot serve now"),
    ],
)
def test_what_the_store_refuses_is_said_in_words_and_stores_nothing(
    status: int, code: str, kind: type[RevisitError], says: str, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with refusing(status, code) as url:
        for name, value in aws(url).items():
            monkeypatch.setenv(name, value)
        store = open_store(sqlite_url(data), data, 0, ADDRESS)
        with pytest.raises(kind, match=says):
            enroll(store, "gate")
        assert store.maps.all() == []
        assert says in store.check()
        with pytest.raises(kind, match=says):
            store._images.read("0" * 64)
        store.close()


@pytest.fixture
def objects(monkeypatch: pytest.MonkeyPatch) -> ObjectStore:
    """An empty store, which the environment names."""
    store = server()
    store.empty()
    for name, value in aws(store.url).items():
        monkeypatch.setenv(name, value)
    return store


def test_a_deletion_goes_through_while_the_store_is_away_and_its_image_follows(
    data: Path, objects: ObjectStore
) -> None:
    store = open_store(sqlite_url(data), data, 0, ADDRESS)
    view = enroll(store, "gate").view
    objects.stop()
    try:
        assert "cannot be reached" in store.check()
        removal = store.removals.delete_view(view.id)
        assert (removal.views, removal.images) == (1, 0)
    finally:
        objects.start()
    assert len(objects.names()) == 1
    assert store.check() == "ok"
    assert objects.names() == []
    store.close()


def test_a_service_that_starts_beside_another_leaves_its_calls_alone(data: Path, tmp_path: Path) -> None:
    with postgres_schema() as url:
        first = open_store(url, data)
        first.recover()
        assert first.calls.begin("call", "print", NOW) is None
        second = open_store(url, tmp_path)
        second.recover()
        with pytest.raises(Conflict):
            first.calls.begin("call", "print", NOW)
        second.close()
        first.close()
        third = open_store(url, tmp_path)
        third.recover()
        assert third.calls.begin("call", "print", NOW) is None
        third.close()


def test_a_database_that_is_new_removes_no_images(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    """They are another database's, whose address was forgotten, or all that is left of one whose file was lost."""
    digest = facts(image("gate")).sha256
    place.put(digest, image("gate"))
    place.store.recover()
    assert "the database is new, and there are images already, which are kept" in caplog.text
    place.store.close()
    place.store = place.open()
    assert place.digests() == [digest]


def test_doctor_finds_nothing_where_images_were_moved_to_the_other_place(data: Path, objects: ObjectStore) -> None:
    """By `aws s3 sync`, which takes all that lies there: locks of the folder, and signs of life of the object store."""
    put_tables(data)
    url = sqlite_url(data)
    with closing(open_store(url, data)) as store:
        enroll(store, "gate")
        describe_all(store)
        store.recover()

    objects.take(data / "pictures")
    with closing(open_store(url, data, images=ADDRESS)) as store:
        store.refuse_foreign()
        store.recover()
        store.tend()
        enroll(store, "pond")
        describe_all(store)
    assert list(examine(url, data, images=ADDRESS)) == []

    shutil.rmtree(data / "pictures")
    objects.give(data / "pictures")
    assert (data / "pictures" / ALIVE).exists()
    with closing(open_store(url, data)) as store:
        store.refuse_foreign()
        store.recover()
    assert list(examine(url, data)) == []
