"""Images of one request are answered each by itself."""

import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from app.http import enrolment_presenters
from app.http.recognise import Recogniser
from schemas.errors import Busy, NotFound, RevisitError
from schemas.records import ViewAttributes, ViewRecord
from schemas.settings import Settings
from tests.http.fakes import FakeRecogniser, FakeRuntime
from tests.http.test_enroll import files
from tests.openapi import CheckedClient
from tests.sample_images import photo
from tests.waiting import PATIENCE_S, until
from worker.service.enroll import Accepted
from worker.service.settlements import Settlements


def test_one_that_is_deleted_while_it_waits_does_not_hide_what_became_of_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """They are enrolled: an error for all of them would say that they are not."""

    def submit(data: bytes, *_: object, **__: object) -> Any:
        submitted = SimpleNamespace(view=SimpleNamespace(id=data.decode()), job_id="job")
        return Accepted(submitted, 0.0, 0.0, None, {})  # type: ignore[arg-type]

    def look(view_id: str) -> ViewRecord:
        if view_id == "deleted":
            raise NotFound("view", view_id)
        return SimpleNamespace(id=view_id, state="ready")  # type: ignore[return-value]

    enroll = Mock(submit=submit, outcome=lambda accepted, view: view.id)
    monkeypatch.setattr(enrolment_presenters, "enrolled", str)
    recogniser = Recogniser(enroll, Mock(), Settlements(Mock(get=look)), 1, 30.0)
    images: list[tuple[str | None, bytes]] = [(None, name.encode()) for name in ("first", "deleted", "last")]
    found: list[Any] = asyncio.run(recogniser.enroll(images, "campus", ViewAttributes(), True, refuse_poor=None))

    assert [found[0], found[2]] == ["first", "last"]
    assert isinstance(found[1], RevisitError)
    assert "deleted" in found[1].detail


def test_several_of_which_some_may_be_taken_later_are_not_repeated_from_memory(
    client: CheckedClient, recogniser: FakeRecogniser, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The queue has room for one; the call is repeated with its key once there is room for all."""
    whole, keyed = recogniser._enroll, {"Idempotency-Key": "walk-7"}
    room = iter([True, False, False, *[True] * 9])

    def full(*given: Any) -> Any:
        return whole(*given) if next(room) else Busy("1000 wait", 17)

    monkeypatch.setattr(recogniser, "_enroll", full)

    first = client.post("/enroll", files=files(photo(1), photo(2), photo(3)), headers=keyed)
    assert (first.status_code, first.headers["retry-after"]) == (207, "17")
    assert [error["status"] for error in first.json()["errors"]] == [429, 429]

    again = client.post("/enroll", files=files(photo(1), photo(2), photo(3)), headers=keyed)
    assert again.status_code == 201
    assert "idempotent-replayed" not in again.headers
    assert [view["created"] for view in again.json()["views"]] == [False, True, True]

    for lasts in (RevisitError("a worker took this image 3 times"), NotFound("view", "1")):
        monkeypatch.setattr(
            recogniser, "_enroll", lambda *given, error=lasts: error if given[0] == photo(6) else whole(*given)
        )
        failed = client.post("/enroll", files=files(photo(5), photo(6)))
        assert (failed.status_code, "retry-after" in failed.headers) == (207, False)
    monkeypatch.setattr(recogniser, "_enroll", whole)
    partly = [client.post("/enroll", files=files(photo(4), b"no"), headers={"Idempotency-Key": "8"}) for _ in range(2)]
    assert [answer.status_code for answer in partly] == [207, 207]
    assert "idempotent-replayed" in partly[1].headers
    assert "retry-after" not in partly[1].headers


def test_the_bytes_of_images_go_once_these_are_stored(monkeypatch: pytest.MonkeyPatch) -> None:
    """A description may be waited for, with what was sent beside it."""
    stored, described = threading.Event(), threading.Event()

    def submit(data: bytes, *_: object, **__: object) -> Any:
        return Accepted(SimpleNamespace(view=SimpleNamespace(id="1"), job_id="job"), 0.0, 0.0, None, {})  # type: ignore[arg-type]

    def look(view_id: str) -> ViewRecord:
        assert described.wait(PATIENCE_S)
        return SimpleNamespace(id=view_id, state="ready")  # type: ignore[return-value]

    monkeypatch.setattr(enrolment_presenters, "enrolled", str)
    enroll = Mock(submit=submit, outcome=lambda accepted, view: view.id)
    recogniser = Recogniser(enroll, Mock(), Settlements(Mock(get=look)), 1, 30.0)
    images: list[tuple[str | None, bytes]] = [(None, b"first"), (None, b"second")]

    async def story() -> list[Any]:
        enrolling = asyncio.create_task(
            recogniser.enroll(images, "campus", ViewAttributes(), True, refuse_poor=None, stored=stored.set)
        )
        assert await asyncio.to_thread(stored.wait, PATIENCE_S)
        assert images == []
        described.set()
        return list(await enrolling)

    assert asyncio.run(story()) == ["1", "1"]


def test_enrolments_that_wait_for_their_descriptions_take_no_memory_for_bodies() -> None:
    fake = FakeRuntime(settings=Settings(max_body_mb=2, bodies_mb=2, max_megapixels=1))
    fake.recogniser.hold = asyncio.Event()
    large = photo() + bytes(1_500_000)
    with CheckedClient(fake.app()) as client, ThreadPoolExecutor(2) as threads:

        def status(number: int) -> int:
            headers = {"content-type": "image/jpeg"}
            return int(client.post(f"/enroll?map=m{number}", content=large, headers=headers).status_code)

        statuses = [threads.submit(status, number) for number in range(2)]
        until(lambda: fake.recogniser.enrolments == 2)
        assert client.portal is not None
        client.portal.call(fake.recogniser.hold.set)
        assert [one.result(PATIENCE_S) for one in statuses] == [201, 201]
