"""Blurred images in place of those that were sent: found again by what was sent, whole in snapshots, never mixed up."""

from pathlib import Path

import pytest
import sqlalchemy as sa

from schemas.blur import BLUR_WORDS
from schemas.enrolment import EnrolmentOptions
from schemas.errors import BlurChanged, Conflict, Damaged, NotFound
from schemas.inbox import QueryToKeep
from schemas.map_changes import MapChanges
from schemas.records import Covered, Submitted, ViewAttributes
from tests.storage.carried import made, views
from tests.storage.conftest import Open
from tests.storage.material import NOW, RECIPE, describe_all, description, enroll, facts, image
from tests.storage.test_forgetting import digests, files
from worker.storage.examining import examine
from worker.storage.repairing import repair
from worker.storage.store import SqlStore
from worker.storage.tables import MAPS, VIEWS

PEOPLE = ("people",)


def blurred(
    store: SqlStore, name: str, *, version: str = "blurred", words: tuple[str, ...] = PEOPLE, place: str | None = None
) -> Submitted:
    """Enrol the blurred version of the image of that name."""
    stored = image(f"{name} {version}")
    found = Covered(words, facts(image(name)).sha256)
    options = EnrolmentOptions(NOW, RECIPE)
    return store.enrolment.submit("campus", stored, facts(stored), ViewAttributes(place), options, found)


@pytest.fixture
def campus(store: SqlStore) -> SqlStore:
    """A map that blurs people, with one described view."""
    store.maps.put("campus", RECIPE, NOW)
    assert store.maps.change("campus", MapChanges(blur=PEOPLE)).blur == PEOPLE
    blurred(store, "gate")
    describe_all(store)
    return store


def test_what_was_sent_is_found_again_and_is_nowhere_on_the_disk(campus: SqlStore, data: Path) -> None:
    [view] = views(campus)
    again = blurred(campus, "gate")
    assert (again.created, again.view.id) == (False, view.id)
    assert files(data) == digests("gate blurred")
    assert campus.views.image(view.id) == image("gate blurred")
    assert campus.enrolment.known("campus", facts(image("gate")).sha256, ViewAttributes()) is not None
    assert campus.enrolment.known("campus", facts(image("yard")).sha256, ViewAttributes()) is None
    with pytest.raises(Conflict, match="another place"):
        blurred(campus, "gate", place="yard")


def test_the_blurred_image_sent_back_is_its_view(campus: SqlStore, data: Path) -> None:
    again = blurred(campus, "gate blurred", version="once more")
    assert (again.created, again.view.id) == (False, views(campus)[0].id)
    assert files(data) == digests("gate blurred")


def test_two_images_of_which_the_same_is_left_are_one_view(campus: SqlStore) -> None:
    other = image("gate with a man")
    stored = image("gate blurred")
    covered = Covered(PEOPLE, facts(other).sha256)
    same = campus.enrolment.submit(
        "campus", stored, facts(stored), ViewAttributes(), EnrolmentOptions(NOW, RECIPE), covered
    )
    assert (same.created, len(views(campus))) == (False, 1)


def test_an_image_blurred_otherwise_leaves_no_second_file(campus: SqlStore, data: Path) -> None:
    again = blurred(campus, "gate", version="by a newer network")
    assert (again.created, again.view.image.sha256) == (False, facts(image("gate blurred")).sha256)
    assert files(data) == digests("gate blurred")


def test_a_damaged_image_is_replaced_by_one_blurred_otherwise(campus: SqlStore, data: Path, database_url: str) -> None:
    [path] = [path for path in data.glob("pictures/*/*/*") if path.is_file()]
    path.write_bytes(b"damaged")
    [view] = views(campus)
    again = blurred(campus, "gate", version="by a newer network")
    assert (again.view.id, again.view.state) == (view.id, "ready")
    assert campus.views.image(view.id) == image("gate by a newer network")
    assert files(data) == digests("gate by a newer network")
    assert list(examine(database_url, data)) == []


def test_a_failed_view_is_tried_again_with_what_is_sent_now(campus: SqlStore, data: Path) -> None:
    blurred(campus, "fog")
    [claim] = campus.jobs.claim("worker", 1)
    campus.jobs.fail(claim, "nothing-static", "only fog", NOW)
    again = blurred(campus, "fog", version="by a newer network")
    assert (again.created, again.view.state) == (False, "pending")
    describe_all(campus)
    assert campus.views.get(again.view.id).state == "ready"
    assert files(data) == digests("gate blurred", "fog by a newer network")


@pytest.mark.parametrize("words", [("vehicles",), ("people", "vehicles")])
def test_nothing_is_stored_that_was_blurred_by_other_words(
    campus: SqlStore, data: Path, words: tuple[str, ...]
) -> None:
    with pytest.raises(BlurChanged):
        blurred(campus, "yard", words=words)
    with pytest.raises(BlurChanged):
        enroll(campus, "yard")
    campus.maps.change("campus", MapChanges(blur=()))
    with pytest.raises(BlurChanged):
        blurred(campus, "yard")
    assert files(data) == digests("gate blurred")
    assert len(views(campus)) == 1


def test_what_a_map_once_blurred_is_not_enrolled_again_beside_it(campus: SqlStore, data: Path) -> None:
    campus.maps.change("campus", MapChanges(blur=()))
    again = enroll(campus, "gate")
    assert (again.created, again.view.image.sha256) == (False, facts(image("gate blurred")).sha256)
    assert files(data) == digests("gate blurred")


def test_words_are_added_before_the_first_view_alone(campus: SqlStore) -> None:
    with pytest.raises(Conflict, match="stored with vehicles to be seen"):
        campus.maps.change("campus", MapChanges(blur=("people", "vehicles")))
    assert campus.maps.blur("campus") == PEOPLE
    assert campus.maps.change("campus", MapChanges(blur=PEOPLE)).blur == PEOPLE
    assert campus.maps.change("campus", MapChanges(blur=())).blur == ()
    with pytest.raises(Conflict):
        campus.maps.change("campus", MapChanges(blur=PEOPLE))
    campus.removals.delete_view(views(campus)[0].id)
    assert campus.maps.change("campus", MapChanges(blur=BLUR_WORDS)).blur == BLUR_WORDS
    with pytest.raises(NotFound):
        campus.maps.change("moon", MapChanges(blur=PEOPLE))
    assert campus.maps.blur("moon") == ()


def test_kept_queries_of_before_go_and_later_ones_are_blurred_or_not_kept(store: SqlStore) -> None:
    store.maps.put("campus", RECIPE, NOW)
    store.maps.change("campus", MapChanges(keep_queries=9))
    keep = store.kept_queries.keep
    keep("campus", QueryToKeep("a", RECIPE.description, description(1), image("a"), NOW))
    store.maps.change("campus", MapChanges(blur=PEOPLE))
    assert store.kept_queries.newest("campus", 9) == ([], 0)
    keep("campus", QueryToKeep("b", RECIPE.description, description(1), image("b"), NOW))
    keep("campus", QueryToKeep("c", RECIPE.description, description(1), image("c"), NOW, None, PEOPLE))
    assert [query.id for query in store.kept_queries.newest("campus", 9)[0]] == ["c"]


@pytest.mark.parametrize("stored", ["{}", "[1]", "not JSON", '["people"'])
def test_settings_that_cannot_be_read_blur_everything(campus: SqlStore, stored: str) -> None:
    with campus._database.writing() as connection:
        connection.execute(sa.update(MAPS).values(blur=stored, checksum=MAPS.c.checksum))
    assert campus.maps.blur("campus") == campus.maps.get("campus").blur == BLUR_WORDS
    with pytest.raises(BlurChanged):
        enroll(campus, "yard")


def test_repair_keeps_what_is_blurred(campus: SqlStore, data: Path, database_url: str) -> None:
    with campus._database.writing() as connection:
        connection.execute(sa.update(MAPS).values(blur='["peop', checksum=MAPS.c.checksum))
    campus.close()
    repair(database_url, data)
    assert list(examine(database_url, data)) == []


def test_damaged_attributes_are_those_that_are_sent_now(campus: SqlStore) -> None:
    with campus._database.writing() as connection:
        connection.execute(sa.update(VIEWS).values(place="flipped", checksum=VIEWS.c.checksum))
    again = blurred(campus, "gate", place="gate")
    describe_all(campus)
    assert campus.views.get(again.view.id).attributes.place == "gate"
    assert blurred(campus, "gate", place="gate").view.id == again.view.id


def test_a_snapshot_carries_blurred_images_and_what_was_sent(campus: SqlStore, elsewhere: SqlStore) -> None:
    blurred(campus, "yard")
    elsewhere.restoring.restore(made(campus), None, NOW)
    assert elsewhere.maps.get("campus").blur == PEOPLE
    [gate, _] = views(elsewhere)
    assert elsewhere.views.image(gate.id) == image("gate blurred")
    again = blurred(elsewhere, "gate")
    assert (again.created, again.view.id) == (False, gate.id)


def test_a_crash_while_enrolling_leaves_nothing(campus: SqlStore, data: Path, reopen: Open) -> None:
    # The file is durable before its row: a kill in between leaves it, blurred, until the next start.
    images = campus.enrolment._images
    with pytest.raises(KeyboardInterrupt), images.kept(facts(image("yard blurred")).sha256, image("yard blurred")):
        raise KeyboardInterrupt
    campus.close()
    store = reopen()
    store.recover()
    assert files(data) == digests("gate blurred")
    with pytest.raises(Damaged):
        store.enrolment._images.read(facts(image("yard blurred")).sha256)
