"""What is deleted while an import runs does not come back when the import goes on after a crash."""

import pytest
import sqlalchemy as sa

from schemas.enrolment import EnrolmentOptions
from schemas.errors import ViewDeleted
from schemas.map_changes import MapChanges
from schemas.records import Covered, Filters, JobProgress, MapClaim, ViewRecord
from tests.storage.material import NO_ATTRIBUTES, NOW, RECIPE, enroll, facts, image
from tests.storage.test_map_jobs import IMPORT, listed
from worker.storage.store import SqlStore
from worker.storage.tables import DELETED_IMAGES


def importing(store: SqlStore) -> MapClaim:
    """An import into the map ``campus`` that is running."""
    store.jobs.queue_import(IMPORT, "campus", RECIPE, NOW)
    claim = store.jobs.claim_map_job("worker", NOW)
    assert claim is not None
    return claim


def imported(store: SqlStore, claim: MapClaim, name: str, sent: str | None = None) -> ViewRecord:
    """The view of an image that an import enrols; `sent`: what was sent, where it was blurred to that image."""
    covered = None if sent is None else Covered(("car",), facts(image(sent)).sha256)
    body = image(name)
    options = EnrolmentOptions(NOW, job=claim)
    submitted = store.enrolment.submit("campus", body, facts(body), NO_ATTRIBUTES, options, covered)
    return submitted.view


def noted(store: SqlStore) -> int:
    with store._database.reading() as connection:
        return int(connection.scalar(sa.select(sa.func.count()).select_from(DELETED_IMAGES)) or 0)


def test_what_was_deleted_while_an_import_ran_does_not_come_back_with_it(store: SqlStore) -> None:
    claim = importing(store)
    gate, _, hall = (imported(store, claim, name) for name in ("gate", "pond", "hall"))
    store.removals.delete_view(gate.id)
    store.removals.delete_views("campus", Filters(exclude=(hall.id,)))
    store.jobs.release_map_job(claim)
    resumed = store.jobs.claim_map_job("worker", NOW)
    assert resumed is not None

    for name in ("gate", "pond"):
        with pytest.raises(ViewDeleted, match="its view was deleted"):
            imported(store, resumed, name)

    imported(store, resumed, "hall")
    imported(store, resumed, "stairs")
    assert len(listed(store)) == 2
    assert enroll(store, "gate").created, "whoever sends it again by itself wants it"
    assert not enroll(store, "gate").created
    assert noted(store) == 2
    store.jobs.finish_import(resumed, JobProgress(4, 4), {}, NOW)
    assert noted(store) == 0


def test_a_blurred_image_that_was_deleted_is_known_by_what_was_sent(store: SqlStore) -> None:
    store.maps.put("campus", RECIPE, NOW)
    store.maps.change("campus", MapChanges(blur=("car",)))
    claim = importing(store)
    view = imported(store, claim, "blurred", sent="gate")
    store.removals.delete_view(view.id)
    for again in ("blurred", "blurred otherwise"):
        with pytest.raises(ViewDeleted):
            imported(store, claim, again, sent="gate")
    assert listed(store) == []


def test_an_enrolment_that_is_taken_back_keeps_no_import_from_its_image(store: SqlStore) -> None:
    claim = importing(store)
    store.removals.delete_view(enroll(store, "gate").view.id, undoes=True)
    assert imported(store, claim, "gate").state == "pending"


@pytest.mark.parametrize("ended", ["failed", "cancelled", "deleted with its map", "done before"])
def test_notes_of_what_was_deleted_end_with_the_import(store: SqlStore, ended: str) -> None:
    claim = importing(store)
    view = imported(store, claim, "gate")
    if ended == "done before":
        store.jobs.finish_import(claim, JobProgress(1, 1), {}, NOW)
    store.removals.delete_view(view.id)
    assert noted(store) == (ended != "done before")
    if ended == "failed":
        store.jobs.fail_map_job(claim, "internal", "oh", NOW)
    elif ended == "cancelled":
        store.jobs.cancel(claim.job_id, NOW)
    elif ended == "deleted with its map":
        store.removals.delete_map("campus")
    assert noted(store) == 0
