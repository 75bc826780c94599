"""Rows that do not fit their checksum, as the store meets them."""

import hashlib

import pytest

from schemas.errors import Damaged
from worker.storage.store import SqlStore


def test_a_damaged_vocabulary_is_not_given_out(store: SqlStore) -> None:
    store.vocabularies.keep(hashlib.sha256(b"tensors").hexdigest(), b"tensorz")
    with pytest.raises(Damaged, match="vocabulary"):
        store.vocabularies.get(hashlib.sha256(b"tensors").hexdigest())
