"""A service behind a URL is measured like one in this process."""

import json
from pathlib import Path
from typing import Any, cast

import pytest

from lab.datasets.dataset import Dataset
from lab.evaluation.remote import connect
from schemas.errors import RevisitError
from schemas.records import Position
from tests import answers
from tests.cli.fake_service import FakeService, fake_service

VERSION = {
    "version": "1", "encoder": "compact", "weights": "w", "preset": "default", "schema_version": "1",
    "python": "3", "libraries": {},
}  # fmt: skip


def replies(service: FakeService) -> None:
    """Let the fake answer; whatever map is asked for, it makes one named m."""

    class AnyMap(dict[str, Any]):
        def get(self, key: str, default: Any = None) -> Any:
            if key.startswith("PUT /maps/evaluation-"):
                return 200, answers.map_facts("m")
            return super().get(key, default)

    service.replies = AnyMap(
        {
            "GET /version": (200, VERSION),
            "DELETE /maps/m": (200, {"views": 1, "images": 1, "revision": None}),
            "POST /enroll": (201, answers.enrolled()),
            "POST /query": (200, answers.query_answer(answers.match())),
        }
    )


def test_a_map_of_its_own_is_used_and_removed(tmp_path: Path) -> None:
    image = tmp_path / "a.jpg"
    image.write_bytes(b"image")
    with fake_service() as service:
        replies(service)
        with connect(service.url, "paper").open(cast(Dataset, None)) as retriever:
            assert retriever.name == "paper"
            assert retriever.enroll(image, Position(x=1, y=2)) == answers.ID
            answer = retriever.query(image, 3)

    assert answer.views == answer.before == (answers.ID,)
    assert answer.status == "matched"
    calls = [path for path, _ in service.requests]
    assert json.loads(service.requests[0][1]) == {"preset": "paper"}
    assert calls[-1] == "DELETE /maps/m"
    plain = [body for path, body in service.requests if path == "POST /query"][1]
    assert b'name="candidates"' in plain


def test_a_refusal_keeps_its_code(tmp_path: Path) -> None:
    image = tmp_path / "a.jpg"
    image.write_bytes(b"image")
    with fake_service() as service:
        replies(service)
        service.replies["POST /enroll"] = 422, answers.problem("nothing-static", 422)
        with (
            connect(service.url, "default").open(cast(Dataset, None)) as retriever,
            pytest.raises(RevisitError) as caught,
        ):
            retriever.enroll(image, Position())

    assert caught.value.code == "nothing-static"


def test_what_is_described_later_is_waited_for(tmp_path: Path) -> None:
    image = tmp_path / "a.jpg"
    image.write_bytes(b"image")
    with fake_service() as service:
        replies(service)
        service.replies["POST /enroll"] = 202, answers.enrolled() | {"job": answers.JOB}
        service.replies[f"GET /jobs/{answers.JOB}"] = 200, answers.job()
        with connect(service.url, "default").open(cast(Dataset, None)) as retriever:
            assert retriever.enroll(image, Position()) == answers.ID
            assert [path for path, _ in service.requests][-1] == f"GET /jobs/{answers.JOB}"

            reason = {"code": "nothing-static", "detail": "all of it moves"}
            service.replies[f"GET /jobs/{answers.JOB}"] = 200, answers.job("failed", failure=reason)
            with pytest.raises(RevisitError, match="all of it moves") as caught:
                retriever.enroll(image, Position())
    assert caught.value.code == "nothing-static"


def test_answers_are_kept_although_the_service_goes_before_its_map_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image = tmp_path / "a.jpg"
    image.write_bytes(b"image")
    with fake_service() as service:
        replies(service)
        service.replies["DELETE /maps/m"] = 500, answers.problem("internal", 500)
        with connect(service.url, "default").open(cast(Dataset, None)) as retriever:
            retriever.enroll(image, Position())
            answer = retriever.query(image, 3)

    assert answer.status == "matched"
    assert "the map m is left there: `./revisit maps m --delete`" in capsys.readouterr().err
