"""`POST /query` reads its parameters, or lists all mistakes in them."""

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from app.http.parameters import MOST_METADATA
from schemas.errors import Busy, EncoderAway, NothingStatic, SetupError
from schemas.records import Filters
from tests.http.fakes import FakeRecogniser, FakeRuntime
from tests.openapi import CheckedClient
from tests.sample_images import photo

JPEG = {"content-type": "image/jpeg"}


@pytest.fixture(autouse=True)
def _enrolled(client: CheckedClient) -> None:
    client.post("/enroll", content=photo(), headers=JPEG)


def test_defaults(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    answer = client.post("/query", content=photo(1), headers=JPEG)
    assert answer.status_code == 200
    assert recogniser.given == {
        "map": "default",
        "top": 5,
        "candidates": None,
        "precision": None,
        "zoom": 1,
        "roll": 0,
        "filters": Filters(),
        "explain": False,
        "drive": None,
        "drive_timeout_s": 60,
        "consistent": None,
        "call": None,
        "keep": True,
    }


def test_a_call_of_a_drive_has_a_key(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    address = "/query?drive=robot-7"
    sent = client.post(address, content=photo(1), headers={**JPEG, "Idempotency-Key": "41"})
    assert (sent.status_code, recogniser.given["call"]) == (200, "41")
    refused = client.post(address, content=photo(1), headers={**JPEG, "Idempotency-Key": "4 1"})
    assert (refused.status_code, refused.json()["errors"][0]["parameter"]) == (422, "Idempotency-Key")


def test_every_parameter_arrives(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    attributes = {
        "top": "100",
        "candidates": "0",
        "precision": "0.99",
        "explain": "true",
        "near": "48.1, 11.5, 250",
        "frame": "geo",
        "after": "2026-01-01T00:00:00Z",
        "before": "2026-01-02T00:00:00.5Z",
        "place": "hall",
        "metadata.camera": "front",
        "metadata.floor": "2",
        "exclude_last": "30s",
        "exclude": "0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b90,b",
    }
    assert client.post("/query", files={"image": photo(1)}, data=attributes).status_code == 200
    assert recogniser.given["filters"] == Filters(
        near=(48.1, 11.5, 250.0),
        geographic=True,
        after=datetime(2026, 1, 1, tzinfo=UTC),
        before=datetime(2026, 1, 2, 0, 0, 0, 500_000, tzinfo=UTC),
        place="hall",
        metadata={"camera": "front", "floor": "2"},
        exclude_last=timedelta(seconds=30),
        exclude=("0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b90", "b"),
    )
    assert recogniser.given["candidates"] == 0
    assert recogniser.given["precision"] == 0.99


def test_several_maps_arrive_as_they_were_named(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    client.post("/enroll?map=floor2", content=photo(), headers=JPEG)
    assert client.post("/query?maps=floor2, floor1", content=photo(1), headers=JPEG).status_code == 200
    assert recogniser.given["map"] == "floor2,floor1"


@pytest.mark.parametrize("precision", ["0.4", "1", "nan", "sure"])
def test_a_precision_out_of_range_is_refused(client: CheckedClient, precision: str) -> None:
    answer = client.post("/query", files={"image": photo(1)}, data={"precision": precision})
    assert answer.status_code == 422
    assert [error["parameter"] for error in answer.json()["errors"]] == ["precision"]


def test_exclude_last_counts_views_without_a_unit(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    client.post("/query?exclude_last=10", content=photo(1), headers=JPEG)
    assert recogniser.given["filters"].exclude_last == 10


ERRORS: list[tuple[dict[str, Any], list[str]]] = [
    ({"top": "0"}, ["top"]),
    ({"top": "101"}, ["top"]),
    ({"top": "five"}, ["top"]),
    ({"top": ""}, ["top"]),
    ({"top": "1.5"}, ["top"]),
    ({"candidates": "501"}, ["candidates"]),
    ({"candidates": "-1"}, ["candidates"]),
    ({"explain": "si"}, ["explain"]),
    ({"drive": "two words"}, ["drive"]),
    ({"maps": "floor1,"}, ["maps"]),
    ({"maps": "floor 1,floor2"}, ["maps"]),
    ({"maps": "floor1,floor1"}, ["maps"]),
    ({"maps": ",".join(f"floor{i}" for i in range(17))}, ["maps"]),
    ({"maps": "floor1,floor2", "map": "floor3"}, ["maps"]),
    ({"maps": "floor1,floor2", "drive": "monday"}, ["maps"]),
    ({"drive": "monday", "drive_timeout": "0"}, ["drive_timeout"]),
    ({"function-x": "1"}, ["function-x"]),
    ({"near": "1,2"}, ["near"]),
    ({"near": "1,2,x"}, ["near"]),
    ({"near": "1,2,0"}, ["near"]),
    ({"near": "1e200,2,1e300"}, ["near"]),
    ({"near": "1,nan,3"}, ["near"]),
    ({"near": "1,2,inf"}, ["near"]),
    ({"near": "91,2,3", "frame": "geo"}, ["near"]),
    ({"near": "1,2,3", "frame": "mars"}, ["frame"]),
    ({"frame": "geo"}, ["frame"]),
    ({"after": "yesterday"}, ["after"]),
    ({"after": "2026-01-02T00:00:00Z", "before": "2026-01-01T00:00:00Z"}, ["after"]),
    ({"exclude_last": "-1"}, ["exclude_last"]),
    ({"exclude_last": "30m"}, ["exclude_last"]),
    ({"exclude_last": "9999999999"}, ["exclude_last"]),
    ({"exclude": "a,,b"}, ["exclude"]),
    ({"exclude": "'; drop table"}, ["exclude"]),
    ({"metadata": "{}"}, ["metadata"]),
    ({"metadata.": "x"}, ["metadata."]),
    ({"x": "1"}, ["x"]),
    ({"wait": "true"}, ["wait"]),
    ({"top": ["1", "2"]}, ["top"]),
    ({"metadata.a": ["1", "2"]}, ["metadata.a"]),
    ({"top": "0", "candidates": "x", "nonsense": "1", "near": "1"}, ["candidates", "near", "nonsense", "top"]),
]


@pytest.mark.parametrize(("attributes", "wrong"), ERRORS, ids=lambda value: str(value)[:50])
def test_a_parameter_that_cannot_be_used_is_named(
    client: CheckedClient, attributes: dict[str, Any], wrong: list[str]
) -> None:
    for answer in (
        client.post("/query", content=photo(), params=attributes, headers=JPEG),
        client.post("/query", files={"image": photo()}, data=attributes),
    ):
        assert answer.status_code == 422
        assert answer.json()["type"].endswith(":invalid-parameter")
        assert sorted({e["parameter"] for e in answer.json()["errors"]}) == wrong


def test_an_unknown_parameter_is_answered_with_the_known_ones(client: CheckedClient) -> None:
    answer = client.post("/query?journey=monday-7", content=photo(), headers=JPEG)
    assert answer.json()["detail"] == (
        "journey: is unknown; known are after, before, candidates, changes, consistent, drive, drive_timeout, exclude, "
        "exclude_last, explain, frame, map, maps, "
        "metadata.KEY, near, place, precision, roll, top, where, zoom"
    )


def test_what_changed_is_told_on_request_alone(client: CheckedClient) -> None:
    assert client.post("/query", content=photo(), headers=JPEG).json()["changes"] is None
    told = client.post("/query?changes=true", content=photo(), headers=JPEG).json()["changes"]
    assert (told["status"], told["changes"]) == ("not-aligned", [])


@pytest.mark.parametrize("away", [Busy.queue(8, 0.5, "images"), EncoderAway("the encoder does not answer", 5)])
def test_a_query_is_answered_although_its_photos_cannot_be_compared_yet(
    client: CheckedClient, runtime: FakeRuntime, away: Busy
) -> None:
    runtime.recogniser.away = away
    answer = client.post("/query?changes=true", content=photo(), headers=JPEG)
    assert answer.status_code == 200
    told = answer.json()["changes"]
    assert (told["status"], told["changes"], told["links"]) == ("busy", [], {})
    assert away.detail in told["detail"]
    assert f"get /queries/{answer.json()['query']['id']}/changes in {away.retry_after_s} s" in told["detail"]


def test_a_query_takes_one_image(client: CheckedClient) -> None:
    answer = client.post("/query", files=[("image", photo(1)), ("image", photo(2))])
    assert answer.json()["errors"] == [{"parameter": "image", "detail": "2 images; a query takes one"}]


def test_metadata_is_filtered_by_so_many_keys(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    """Databases read expressions to a depth, and answer an error of ours beyond."""
    filters = [f"metadata.k{number}=v" for number in range(MOST_METADATA + 1)]
    for method, path in (("POST", "/query?"), ("GET", "/views?"), ("DELETE", "/views?map=default&")):
        image = {"content": photo(), "headers": JPEG} if method == "POST" else {}
        refused = client.request(method, path + "&".join(filters), **image)
        assert (refused.status_code, refused.json()["errors"]) == (
            422,
            [{"parameter": "metadata.KEY", "detail": "65 keys; at most 64 are taken"}],
        )
    assert client.get("/views?" + "&".join(filters[:-1])).status_code == 200
    assert len(recogniser.given["filters"].metadata) == MOST_METADATA


def test_an_unknown_map_is_not_found(client: CheckedClient) -> None:
    answer = client.post("/query?map=nowhere", content=photo(), headers=JPEG)
    assert answer.status_code == 404
    assert "nowhere" in answer.json()["detail"]


@pytest.mark.parametrize(
    ("error", "status"),
    [(NothingStatic("only cars"), 422), (Busy("32 wait", 3), 429), (SetupError("needs the encoder lseg"), 409)],
)
def test_an_error_of_the_use_case_becomes_its_problem(
    client: CheckedClient, recogniser: FakeRecogniser, error: Exception, status: int
) -> None:
    recogniser.fails["query"] = error
    assert client.post("/query", content=photo(), headers=JPEG).status_code == status
