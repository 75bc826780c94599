"""Rows that do not fit their checksum, as the store meets them."""

import hashlib

import pytest
import sqlalchemy as sa

from schemas.errors import Damaged
from schemas.records import Filters, ViewAttributes
from tests.storage.material import describe_all, enroll
from worker.storage.store import SqlStore
from worker.storage.tables import VIEWS


def test_a_damaged_vocabulary_is_not_given_out(store: SqlStore) -> None:
    store.vocabularies.keep(hashlib.sha256(b"tensors").hexdigest(), b"tensorz")
    with pytest.raises(Damaged, match="vocabulary"):
        store.vocabularies.get(hashlib.sha256(b"tensors").hexdigest())


def test_an_image_is_enrolled_again_before_anybody_has_read_its_damaged_attributes(store: SqlStore) -> None:
    enroll(store, "gate")
    describe_all(store)
    with store._database.writing() as connection:
        connection.execute(sa.update(VIEWS).values(place="flipped", checksum=VIEWS.c.checksum))

    again = enroll(store, "gate", attributes=ViewAttributes("gate"))
    describe_all(store)

    view = store.views.get(again.view.id)
    assert (again.created, view.state, view.attributes.place) == (False, "ready", "gate")


def test_a_view_with_damaged_attributes_names_the_file_that_heals_it(store: SqlStore) -> None:
    """What `GET /views/{id}/image` gives may be another file, without EXIF, and would become another view."""
    enroll(store, "gate")
    describe_all(store)
    with store._database.writing() as connection:
        digest = str(connection.scalar(sa.select(VIEWS.c.sha256)))
        connection.execute(sa.update(VIEWS).values(place="flipped", checksum=VIEWS.c.checksum))

    [view] = store.views.list("campus", Filters())[0]
    [view] = store.views.list("campus", Filters())[0]  # it is set aside when it is read

    assert view.failure is not None
    assert digest in view.failure[1]
    assert store._images.read(digest)
