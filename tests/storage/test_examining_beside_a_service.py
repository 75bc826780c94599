"""What is enrolled and deleted while a doctor reads is no damage."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from schemas.records import ViewAttributes
from tests.storage.conftest import Place
from tests.storage.material import describe_all, enroll, image
from worker.storage import examining_images, examining_objects, examining_rows
from worker.storage.examining import examine
from worker.storage.image_objects import ImageObjects
from worker.storage.tables import VIEWS


def test_what_is_enrolled_meanwhile(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    enroll(place.store, "gate")
    describe_all(place.store)
    scan, enrolled = examining_rows.scan, 0

    def meanwhile(connection: sa.Connection, table: sa.TableClause) -> Iterator[Any]:
        nonlocal enrolled
        if table is VIEWS:  # what views have of other tables has been read
            enrolled += 1
            enroll(place.store, f"pond {enrolled}", attributes=ViewAttributes(metadata={"seen": enrolled}))
            describe_all(place.store)
        return scan(connection, table)

    monkeypatch.setattr(examining_rows, "scan", meanwhile)

    assert list(examine(place.url, place.data, running=True, images=place.address)) == []
    assert enrolled == 2


def test_what_is_deleted_meanwhile(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    kept, gone, last = (enroll(place.store, name).view for name in ("gate", "pond", "mill"))
    describe_all(place.store)
    files_below, names, fault = examining_images.files_below, ImageObjects.names, examining_objects._fault

    def before_the_folder_is_read(folder: Path) -> Iterator[Path]:
        place.store.removals.delete_view(gone.id)
        paths = list(files_below(folder))
        place.store.removals.delete_view(last.id)
        return iter(paths)

    def before_they_are_listed(objects: ImageObjects) -> Iterator[str]:
        place.store.removals.delete_view(gone.id)
        return names(objects)

    def before_one_is_read(objects: ImageObjects, digest: str) -> str | None:
        if digest == last.image.sha256:
            place.store.removals.delete_view(last.id)
        return fault(objects, digest)

    monkeypatch.setattr(examining_images, "files_below", before_the_folder_is_read)
    monkeypatch.setattr(ImageObjects, "names", before_they_are_listed)
    monkeypatch.setattr(examining_objects, "_fault", before_one_is_read)

    assert list(examine(place.url, place.data, running=True, images=place.address)) == []
    assert place.store.views.image(kept.id) == image("gate")
    assert place.digests() == [kept.image.sha256]


def test_an_image_that_is_lost_is_told_beside_a_service_too(place: Place) -> None:
    view = enroll(place.store, "gate").view
    describe_all(place.store)
    place.put(view.image.sha256, None)

    [finding] = examine(place.url, place.data, running=True, images=place.address)

    assert finding.what == f"is missing; it is the image of view {view.id}"
