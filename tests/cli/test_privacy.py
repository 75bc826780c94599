"""What the command line prints and changes of what a map keeps."""

import json

import pytest

from app.cli.__main__ import main
from tests.answers import map_facts
from tests.cli.fake_service import FakeService

Out = pytest.CaptureFixture[str]


def test_what_is_blurred_is_changed_and_told(service: FakeService, capsys: Out) -> None:
    service.replies["PATCH /maps/campus"] = (
        200,
        {**map_facts("campus"), "blur": ["people", "car"], "keep_queries": 1000},
    )

    assert main(["privacy", "campus", "--blur", "people, car"]) == 0

    assert capsys.readouterr().out.splitlines() == [
        "campus: images are kept, people and car blurred as far as they are found",
        "    queries that matched nothing: the newest 1,000 are kept",
        "    queries that look unlike what they matched: none is kept",
    ]
    assert [(path, body and json.loads(body)) for path, body in service.requests] == [
        ("PATCH /maps/campus", {"blur": ["people", "car"]}),
    ]


def test_without_options_nothing_is_changed(service: FakeService, capsys: Out) -> None:
    service.replies["GET /maps/default"] = 200, {**map_facts("default"), "keep_images": False}
    service.replies["PATCH /maps/default"] = 200, {**map_facts("default"), "keep_images": False}
    assert main(["privacy", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "name": "default", "blur": [], "keep_images": False, "keep_queries": 0, "keep_matches": 0
    }  # fmt: skip
    assert len(service.requests) == 1
    assert main(["privacy", "--blur", "", "--drop-images"]) == 0
    assert [json.loads(body) for _, body in service.requests[1:]] == [{"blur": [], "keep_images": False}]
    assert capsys.readouterr().out.startswith("default: images are removed once they are described")
