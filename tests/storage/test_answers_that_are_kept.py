"""What answers that are kept to be repeated tell of views that are deleted or changed while calls end."""

import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any
from unittest.mock import Mock

import pytest
import sqlalchemy as sa

from schemas.errors import StorageFailed
from schemas.records import Filters, Position, Replay, ViewAttributes
from tests.storage.carried import views
from tests.storage.material import NOW, describe_all, enroll
from tests.storage.test_receipts import answer, answered, repeated
from worker.storage import answers, removals
from worker.storage.answers import SINCE_CHANGED, SINCE_DELETED, StoredAnswers
from worker.storage.removals import Removals
from worker.storage.store import SqlStore
from worker.storage.tables import CALLS


@pytest.fixture
def campus(store: SqlStore) -> SqlStore:
    """Six described views of six places."""
    for n in range(6):
        enroll(
            store, f"view {n}", attributes=ViewAttributes(f"secret {n}", Position(x=n + 0.25), NOW, {"n": n}, "a.jpg")
        )
    describe_all(store)
    return store


def test_a_call_that_ends_after_a_deletion_tells_nothing_of_the_view(campus: SqlStore) -> None:
    gate, yard = views(campus)[:2]
    late = answer(campus, gate.id, yard.id)
    campus.calls.begin("key", "print", NOW)
    campus.removals.delete_view(gate.id)
    campus.calls.end("key", late, NOW)

    first, second = repeated(campus, "key").views
    assert (first.view.id, first.view.place, first.view.position, first.view.metadata) == (gate.id, None, None, {})
    assert set(first.view.image.sha256) == {"0"}
    assert (second.view.place, second.view.metadata) == ("secret 1", {"n": 1})
    assert [warning.detail for warning in second.warnings] == [SINCE_DELETED]


def test_a_call_that_ends_after_a_change_tells_the_view_as_it_is_now(campus: SqlStore) -> None:
    gate, yard = views(campus)[:2]
    late = answer(campus, gate.id, yard.id)
    campus.calls.begin("key", "print", NOW)
    campus.views.change(gate.id, lambda had: replace(had, place="porch", position=Position(lat=1.0, lon=2.0)))
    campus.calls.end("key", late, NOW)

    first, second = repeated(campus, "key").views
    assert (first.view.place, first.view.position.x, first.view.position.lat) == ("porch", None, 1.0)
    assert (second.view.place, second.warnings[0].detail) == ("secret 1", SINCE_CHANGED)


def test_a_view_that_only_a_warning_names_is_told_as_it_is_now_or_not_at_all(campus: SqlStore) -> None:
    changed, other, own = views(campus)[:3]
    campus.calls.begin("key", "print", NOW)
    body = json.loads(answer(campus, own.id).body)
    body["warnings"] = [
        {"code": "duplicate", "detail": f"it is like {one.attributes.place!r} (view {one.id})", "view": one.id}
        for one in (changed, other)
    ]
    campus.views.change(changed.id, lambda had: replace(had, place="secret"))
    campus.views.change(other.id, lambda had: replace(had, metadata={}))
    campus.calls.end("key", Replay(201, {}, json.dumps(body).encode()), NOW)
    told = repeated(campus, "key").warnings
    assert [warning.detail for warning in told] == [SINCE_CHANGED, f"it is like 'secret 1' (view {other.id})"]


def test_an_answer_is_kept_to_the_letter_where_nothing_changed(campus: SqlStore) -> None:
    """Whatever its words are: a map or a file may be called as views are."""
    some = views(campus)
    same = answer(campus, *(view.id for view in some))
    spaced = json.dumps(json.loads(same.body), indent=1).encode()
    named = f"this image is in the map '{some[0].id[:-4]}0000' already, as {some[1].id}, with another place"
    refused = json.dumps({"status": 409, "detail": named}).encode()
    for key, body in (("same", same.body), ("spaced", spaced), ("refused", refused)):
        campus.calls.begin(key, "print", NOW)
        campus.calls.end(key, Replay(201, {}, body), NOW)
        kept = campus.calls.begin(key, "print", NOW)
        assert kept is not None
        assert kept.body == body


def test_a_refusal_that_names_a_view_which_is_gone_does_not_say_why_any_more(campus: SqlStore) -> None:
    gate = views(campus)[0]
    campus.calls.begin("key", "print", NOW)
    campus.removals.delete_view(gate.id)
    body = json.dumps({"status": 422, "detail": f"nearly the same image is there, as 'secret 0' (view {gate.id})"})
    campus.calls.end("key", Replay(422, {}, body.encode()), NOW)
    kept = campus.calls.begin("key", "print", NOW)
    assert kept is not None
    assert json.loads(kept.body)["detail"] == SINCE_DELETED


def places(store: SqlStore) -> list[str | None]:
    """What the calls ``k0`` to ``k5`` are answered again, of the place of their view."""
    return [repeated(store, f"k{n}").view.place for n in range(6)]


@pytest.fixture
def portions(campus: SqlStore, monkeypatch: pytest.MonkeyPatch) -> SqlStore:
    """Views that are deleted two by two, each with an answer that is kept."""
    monkeypatch.setattr(removals, "PORTION", 2)
    for n, view in enumerate(views(campus)):
        answered(campus, f"k{n}", view.id)
    return campus


@pytest.mark.parametrize("few", [0, 8])
def test_a_deletion_that_breaks_off_and_is_finished_later_leaves_no_answer(
    portions: SqlStore, monkeypatch: pytest.MonkeyPatch, few: int
) -> None:
    monkeypatch.setattr(answers, "FEW", few)
    remove, left = Removals._remove, [1]

    def breaking(self: Removals, map_id: int, seqs: Sequence[int], answers: StoredAnswers) -> Any:
        if not left:
            raise StorageFailed("away")
        left.pop()
        return remove(self, map_id, seqs, answers)

    with monkeypatch.context() as patch:
        patch.setattr(Removals, "_remove", breaking)
        with pytest.raises(StorageFailed):
            portions.removals.delete_map("campus")
    assert places(portions) == [None, None, "secret 2", "secret 3", "secret 4", "secret 5"]

    portions.tend()
    assert portions.removals._finishing is not None
    portions.removals._finishing.join()
    assert places(portions) == [None] * 6


def test_a_deletion_that_is_rolled_back_takes_nothing_from_the_answers(
    portions: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> list[str]:
        raise StorageFailed("away")

    with monkeypatch.context() as patch:
        patch.setattr(removals, "_being_made", refuse)
        with pytest.raises(StorageFailed):
            portions.removals.delete_views("campus", Filters())
    assert None not in places(portions)


@pytest.mark.parametrize("few", [0, 8])
def test_a_call_that_ends_during_a_deletion_tells_nothing_of_what_goes_next(
    portions: SqlStore, monkeypatch: pytest.MonkeyPatch, few: int
) -> None:
    monkeypatch.setattr(answers, "FEW", few)
    last = views(portions)[5]
    late = {key: answer(portions, last.id) for key in ("running", "begun")}
    portions.calls.begin("running", "print", datetime.now(UTC))
    remove = Removals._remove

    def slow(self: Removals, map_id: int, seqs: Sequence[int], answers: StoredAnswers) -> Any:
        gone = remove(self, map_id, seqs, answers)
        for key in list(late):
            if key == "begun":
                portions.calls.begin(key, "print", datetime.now(UTC))
            portions.calls.end(key, late.pop(key), NOW)
        return gone

    monkeypatch.setattr(Removals, "_remove", slow)
    portions.removals.delete_views("campus", Filters())
    assert (repeated(portions, "running").view.place, repeated(portions, "begun").view.place) == (None, None)


def test_all_answers_are_read_once_for_a_deletion_in_portions(
    portions: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a day of calls leaves may be hundreds of megabytes."""
    monkeypatch.setattr(answers, "FEW", 0)
    named = Mock(side_effect=answers.ids_in)
    monkeypatch.setattr(answers, "ids_in", named)
    portions.removals.delete_views("campus", Filters())
    assert named.call_count == 6
    with portions._database.reading() as connection:
        assert connection.scalar(sa.select(sa.func.count()).select_from(CALLS)) == 6
    assert places(portions) == [None] * 6
