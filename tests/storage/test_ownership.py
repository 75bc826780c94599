"""A database removes no images of another one, whoever named the wrong place."""

from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest

from schemas.errors import SetupError
from tests.storage.carried import JOB
from tests.storage.conftest import Place
from tests.storage.databases import data_folder, sqlite_url
from tests.storage.material import enroll, facts, image
from tests.storage.object_store import BUCKET, PREFIX
from tests.storage.test_migrations import set_revision, without_0022
from tests.waiting import until
from worker.storage.database import Database
from worker.storage.examining import examine
from worker.storage.migrating import migrate
from worker.storage.owner_file import OWNER, written
from worker.storage.ownership import id_of
from worker.storage.repairing import repair
from worker.storage.store import SqlStore, open_store


@pytest.fixture
def other(place: Place) -> Iterator[SqlStore]:
    """The store of another database, whose images are to lie at the same place."""
    with data_folder() as folder:
        if place.address is None:
            (folder / "pictures").symlink_to(place.data / "pictures")
        with closing(open_store(sqlite_url(folder), folder, 0, place.address)) as store:
            yield store


def served(place: Place) -> None:
    """The place is taken by its first database, whose sweep has ended: it would take away what another one enrols."""
    place.store.recover()
    sweeper = getattr(place.store._images, "_sweeper", None)
    if sweeper is not None:
        sweeper.join()


def test_another_database_is_not_served_from_there_and_removes_nothing(
    place: Place, other: SqlStore, caplog: pytest.LogCaptureFixture
) -> None:
    theirs = enroll(place.store, "gate").view
    served(place)
    ours = enroll(other, "pond").view

    for _ in range(2):
        other.recover()
    with pytest.raises(SetupError, match="another database"):
        other.refuse_foreign()

    assert set(place.digests()) == {theirs.image.sha256, ours.image.sha256}
    assert place.store.views.image(theirs.id) == image("gate")
    assert "none is removed" in caplog.text


def test_its_own_is_served_from_there_and_swept(place: Place) -> None:
    kept = enroll(place.store, "gate").view
    served(place)
    place.store.close()
    place.store = place.open()
    place.put(facts(image("left")).sha256, image("left"))

    place.store.refuse_foreign()
    served(place)

    until(lambda: place.digests() == [kept.image.sha256])


def test_a_place_that_nobody_has_is_taken_and_one_that_was_given_up_too(place: Place, other: SqlStore) -> None:
    enroll(place.store, "gate")
    served(place)
    first = place.store._images.owner()
    ours = enroll(other, "pond").view
    _give_up(place)

    other.recover()

    assert first is not None
    assert place.store._images.owner() not in (None, first)
    until(lambda: place.digests() == [ours.image.sha256])


def test_a_new_database_takes_no_images_that_are_there_already(place: Place, other: SqlStore) -> None:
    theirs = enroll(place.store, "gate").view  # by a version that told nobody

    other.recover()

    assert place.digests() == [theirs.image.sha256]
    assert place.store._images.owner() is None


def found_and_repaired(place: Place, other: SqlStore) -> list[str]:
    """What the doctor finds, of another database with the images of this place, before it repairs."""
    url, folder = str(other._database.engine.url), other._data
    other.close()
    findings = [finding.what for finding in examine(url, folder, images=place.address)]
    repair(url, folder, images=place.address)
    return findings


def test_the_doctor_calls_none_of_them_orphans_and_removes_none(place: Place, other: SqlStore) -> None:
    theirs = enroll(place.store, "gate").view
    served(place)
    enroll(other, "pond")

    assert found_and_repaired(place, other) == ["says that the images are of another database"]
    assert place.store.views.image(theirs.id) == image("gate")


def test_the_doctor_keeps_what_a_new_database_takes_none_of(place: Place, other: SqlStore) -> None:
    theirs = enroll(place.store, "gate").view  # by a version that told nobody
    other.recover()

    assert found_and_repaired(place, other) == ["holds images already, and nothing was ever enrolled into the database"]
    assert place.store.views.image(theirs.id) == image("gate")


@pytest.mark.parametrize("place", ["objects", "objects, postgresql"], indirect=True)
def test_recordings_and_snapshots_of_another_database_are_not_swept(
    place: Place, other: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None of their jobs is known to it, so that all of them look like what a crash left."""
    assert place.objects is not None
    assert other.leftovers is not None
    assert place.store.leftovers is not None
    for of in (other.leftovers, place.store.leftovers):
        monkeypatch.setattr(of, "sweep", partial(of.sweep, 0.0))  # however young
    enroll(place.store, "gate")
    served(place)
    names = [f"imports/{JOB}/upload", f"snapshots/{JOB}.digests"]
    for name in names:
        place.objects.client.put_object(Bucket=BUCKET, Key=PREFIX + name, Body=b"theirs")
    place.objects.client.create_multipart_upload(Bucket=BUCKET, Key=f"{PREFIX}snapshots/{JOB}.snapshot")
    before = place.objects.names(), place.objects.unfinished()

    assert not other.leftovers.step()
    assert (place.objects.names(), place.objects.unfinished()) == before

    assert place.store.leftovers.step()
    assert not set(names) & set(place.objects.names())
    assert place.objects.unfinished() == []


def test_a_damaged_file_says_nothing_and_is_written_anew(place: Place) -> None:
    enroll(place.store, "gate")
    served(place)
    owner = place.store._images.owner()
    assert owner is not None
    damaged = written(owner).replace(b"-", b"+", 1)
    if place.objects is None:
        (place.data / "pictures" / OWNER).write_bytes(damaged)
    else:
        place.objects.client.put_object(Bucket=BUCKET, Key=PREFIX + OWNER, Body=damaged)

    assert place.store._images.owner() is None
    place.store.refuse_foreign()
    served(place)

    assert place.store._images.owner() == owner


def test_a_database_of_before_gets_the_same_id_each_time_it_is_migrated(database_url: str, data: Path) -> None:
    store = open_store(database_url, data)
    enroll(store, "gate")
    store.close()

    assert len({_migrated_again(database_url, data) for _ in range(2)}) == 1


def _migrated_again(url: str, data: Path) -> str | None:
    """The id of the database, after it was taken away and the tables were migrated."""
    database = Database(url)
    try:
        with database.writing() as connection:
            connection.exec_driver_sql("DROP TABLE installation")
            without_0022(connection)
        set_revision(database, "0020")
        migrate(url, data)
        with database.reading() as connection:
            return id_of(connection)
    finally:
        database.close()


def _give_up(place: Place) -> None:
    if place.objects is None:
        (place.data / "pictures" / OWNER).unlink()
    else:
        place.objects.client.delete_object(Bucket=BUCKET, Key=PREFIX + OWNER)
