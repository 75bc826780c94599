"""Rows that do not fit their checksum, as the store meets them."""

import hashlib

import pytest
import sqlalchemy as sa

from schemas.errors import Damaged
from schemas.records import ViewAttributes
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
