"""A call whose first attempt cannot have an answer any more is not refused for a day."""

from datetime import timedelta

import pytest

from schemas.errors import Conflict, StorageFailed
from tests.storage.material import NOW
from worker.storage.store import SqlStore


def test_a_call_that_cannot_have_an_answer_any_more_may_be_tried_again(store: SqlStore) -> None:
    """Its process was killed while another one of a fleet went on, so that no start cleaned up."""
    store.calls.begin("key", "fingerprint", NOW)
    with pytest.raises(Conflict):
        store.calls.begin("key", "fingerprint", NOW + timedelta(minutes=9))
    assert store.calls.begin("key", "fingerprint", NOW + timedelta(minutes=10)) is None


def test_a_call_that_could_not_be_deleted_when_it_failed_may_be_tried_again(
    store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.calls.begin("key", "fingerprint", NOW)
    with monkeypatch.context() as away:
        away.setattr(store._database, "open", _away)
        with pytest.raises(StorageFailed):
            store.calls.abandon("key")
    assert store.calls.begin("key", "fingerprint", NOW) is None
    with pytest.raises(Conflict):
        store.calls.begin("key", "fingerprint", NOW)


def _away() -> None:
    raise StorageFailed("there is no connection to it")
