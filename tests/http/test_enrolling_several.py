"""Images of one request are answered each by itself."""

import asyncio
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from app.http import enrolment_presenters
from app.http.recognise import Recogniser
from schemas.errors import NotFound, RevisitError
from schemas.records import ViewAttributes, ViewRecord
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
    images = [(None, name.encode()) for name in ("first", "deleted", "last")]
    found: list[Any] = asyncio.run(recogniser.enroll(images, "campus", ViewAttributes(), True, refuse_poor=None))

    assert [found[0], found[2]] == ["first", "last"]
    assert isinstance(found[1], RevisitError)
    assert "deleted" in found[1].detail
