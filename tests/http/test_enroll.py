"""`POST /enroll` takes images and their attributes; a refused request leaves nothing behind."""

import asyncio
import gzip
from datetime import UTC, datetime
from typing import Any

import pytest

from schemas.errors import Busy, DiskFull, NothingStatic
from schemas.records import Position, ViewAttributes
from tests.http.fakes import FakeRecogniser, FakeRuntime
from tests.openapi import CheckedClient
from tests.sample_images import photo

URN = "urn:revisit:problem:"


def code(response: Any) -> str:
    assert response.headers["content-type"] == "application/problem+json"
    return str(response.json()["type"]).removeprefix(URN)


def files(*images: bytes) -> list[tuple[str, tuple[str, bytes, str]]]:
    return [("image", (f"{i}.jpg", data, "image/jpeg")) for i, data in enumerate(images)]


def test_whether_poor_images_are_refused_arrives(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    for wanted in (False, True):
        client.post("/enroll", files=files(photo(5)), data={"refuse_poor": str(wanted).lower()})
        assert recogniser.given["refuse_poor"] is wanted


def test_an_image_is_enrolled_as_multipart(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    answer = client.post(
        "/enroll",
        files=files(photo()),
        data={
            "map": "campus",
            "place": "library",
            "x": "1.5",
            "y": "-2",
            "heading": "359.9",
            "captured_at": "2026-03-01T10:30:00+01:00",
            "metadata": '{"floor": 2}',
        },
    )

    assert answer.status_code == 201
    body = answer.json()
    assert answer.headers["location"] == f"/views/{body['view']['id']}"
    assert body["created"] is True
    assert body["view"]["captured_at"] == "2026-03-01T09:30:00.000000Z"
    assert recogniser.given["said"] == ViewAttributes(
        "library", Position(x=1.5, y=-2.0, heading=359.9), datetime(2026, 3, 1, 9, 30, tzinfo=UTC), {"floor": 2}
    )


@pytest.mark.parametrize("content_type", ["image/jpeg", "image/png", "application/octet-stream", None])
def test_an_image_is_enrolled_as_the_raw_body_whatever_image_type_it_is_called(
    client: CheckedClient, recogniser: FakeRecogniser, content_type: str | None
) -> None:
    headers = {"content-type": content_type} if content_type else {}
    answer = client.post("/enroll?map=m&lat=48.1&lon=11.5", content=photo(), headers=headers)
    assert answer.status_code == 201
    assert recogniser.given["said"].position == Position(lat=48.1, lon=11.5)


def test_parameters_may_stand_in_the_url_of_a_multipart_request(
    client: CheckedClient, recogniser: FakeRecogniser
) -> None:
    assert client.post("/enroll?map=m", files=files(photo()), data={"place": "p"}).status_code == 201
    assert (recogniser.given["map"], recogniser.given["said"].place) == ("m", "p")


def test_a_name_given_in_the_url_and_in_the_body_is_an_error(client: CheckedClient) -> None:
    answer = client.post("/enroll?map=m", files=files(photo()), data={"map": "n"})
    assert code(answer) == "invalid-parameter"
    assert answer.json()["errors"][0]["parameter"] == "map"


def test_an_image_part_needs_no_file_name(client: CheckedClient) -> None:
    body = b'--b\r\nContent-Disposition: form-data; name="image"\r\n\r\n' + photo() + b"\r\n--b--\r\n"
    answer = client.post("/enroll", content=body, headers={"content-type": "multipart/form-data; boundary=b"})
    assert answer.status_code == 201


def test_the_same_bytes_again_answer_200_with_the_view_that_exists(client: CheckedClient) -> None:
    first = client.post("/enroll", files=files(photo()), data={"place": "hall"})
    again = client.post("/enroll", files=files(photo()))
    assert again.status_code == 200
    assert again.json()["created"] is False
    assert again.json()["view"] == first.json()["view"]


def test_the_same_bytes_with_other_attributes_conflict(client: CheckedClient) -> None:
    client.post("/enroll", files=files(photo()), data={"place": "hall"})
    answer = client.post("/enroll", files=files(photo()), data={"place": "cellar"})
    assert (answer.status_code, code(answer)) == (409, "conflict")


def test_not_waiting_answers_202_with_the_job(client: CheckedClient) -> None:
    answer = client.post("/enroll?wait=false", content=photo())
    assert answer.status_code == 202
    assert answer.headers["location"] == f"/jobs/{answer.json()['job']}"


def test_several_images_are_each_answered(client: CheckedClient) -> None:
    answer = client.post("/enroll", files=files(photo(1), photo(2)))
    assert answer.status_code == 201
    assert len(answer.json()["views"]) == 2
    assert answer.json()["errors"] == []

    partly = client.post("/enroll", files=files(photo(3), b"no picture", photo(4)))
    assert partly.status_code == 207
    assert len(partly.json()["views"]) == 2
    (error,) = partly.json()["errors"]
    assert (error["index"], error["filename"], error["status"]) == (1, "1.jpg", 415)
    assert error["type"] == URN + "not-a-picture"


def test_a_place_has_one_name_however_its_accents_are_written(client: CheckedClient) -> None:
    for number, written in enumerate(("Caf\u00e9", "Cafe\u0301")):
        answer = client.post("/enroll", files=files(photo(number)), data={"place": written})
        assert answer.json()["view"]["place"] == "Caf\u00e9"


def test_when_none_of_several_can_be_taken_the_answer_is_an_error(
    client: CheckedClient, recogniser: FakeRecogniser
) -> None:
    answer = client.post("/enroll", files=files(b"one", b"two"))
    assert (answer.status_code, code(answer)) == (415, "not-a-picture")
    assert "image 0" in answer.json()["detail"]
    assert "image 1" in answer.json()["detail"]
    assert not recogniser.kept


@pytest.mark.parametrize(
    ("name", "content", "content_type", "expected"),
    [
        ("nothing", b"", None, (400, "no-picture")),
        ("nothing called jpeg", b"", "image/jpeg", (400, "no-picture")),
        ("empty multipart", b"", "multipart/form-data; boundary=b", (400, "no-picture")),
        ("no boundary", b"--b--", "multipart/form-data", (400, "malformed-body")),
        ("only the end", b"--b--\r\n", "multipart/form-data; boundary=b", (400, "no-picture")),
        ("rubbish", b"rubbish", "multipart/form-data; boundary=b", (400, "malformed-body")),
        ("form", b"image=x", "application/x-www-form-urlencoded", (415, "not-a-picture")),
        ("json", b"{}", "application/json", (415, "not-a-picture")),
        ("mixed", b"--b--\r\n", "multipart/mixed; boundary=b", (415, "not-a-picture")),
        ("text called jpeg", b"I am a picture, honest", "image/jpeg", (415, "not-a-picture")),
        ("truncated", photo()[:-200], "image/jpeg", (422, "undecodable-picture")),
        ("tiny", photo()[:0] + b"BM", "image/bmp", (422, "undecodable-picture")),
    ],
    ids=lambda value: value if isinstance(value, str) and "/" not in value else "",
)
def test_a_body_without_an_image_is_refused_and_leaves_nothing_behind(
    client: CheckedClient,
    recogniser: FakeRecogniser,
    name: str,
    content: bytes,
    content_type: str | None,
    expected: tuple[int, str],
) -> None:
    headers = {"content-type": content_type} if content_type else {}
    answer = client.post("/enroll", content=content, headers=headers)
    assert (answer.status_code, code(answer)) == expected
    assert not recogniser.kept


def multipart(*parts: tuple[str, bytes]) -> bytes:
    return b"".join(b"--b\r\n" + head.encode() + b"\r\n\r\n" + body + b"\r\n" for head, body in parts) + b"--b--\r\n"


IMAGE = 'Content-Disposition: form-data; name="image"; filename="a.jpg"'
FORM = {"content-type": "multipart/form-data; boundary=b"}


def test_a_multipart_body_that_breaks_off_anywhere_is_malformed(
    client: CheckedClient, recogniser: FakeRecogniser
) -> None:
    body = multipart((IMAGE, photo()))
    for cut in (10, 60, 200, len(body) // 2, len(body) - 8, len(body) - 5, len(body) - 4):
        answer = client.post("/enroll", content=body[:cut], headers=FORM)
        assert (answer.status_code, code(answer)) == (400, "malformed-body"), cut
    assert not recogniser.kept


@pytest.mark.parametrize(
    ("sent", "kept"),
    [
        ("filename=\"=?utf-8?B?Z2HDn2UuanBn?=\"; filename*=utf-8''ga%C3%9Fe.jpg", "gaße.jpg"),
        ("filename=a.jpg; filename*=UTF-8'de'..%2Fb%20c.jpg", "b c.jpg"),
        ("filename*=utf-8''d.jpg", "d.jpg"),
        ("filename=e.jpg; filename*=iso-8859-1''%E4.jpg", "e.jpg"),
        ('filename="it\'s; filename.jpg"', "it's; filename.jpg"),
        ("filename=f.jpg; filename*=utf-8''%FF.jpg", "\ufffd.jpg"),
    ],
)
def test_a_name_that_is_not_ascii_is_kept_as_net_sends_it(client: CheckedClient, sent: str, kept: str) -> None:
    head = f'Content-Disposition: form-data; name="image"; {sent}'
    answer = client.post("/enroll", content=multipart((head, photo())), headers=FORM)
    assert (answer.status_code, answer.json()["view"]["filename"]) == (201, kept)


@pytest.mark.parametrize(
    "before", [b"\r\n", b"This is a multi-part message in MIME format.\r\n", b"two\r\n\r\n lines --b\r\n"]
)
def test_what_a_mail_library_writes_before_the_first_part_is_passed_over(client: CheckedClient, before: bytes) -> None:
    answer = client.post("/enroll", content=before + multipart((IMAGE, photo())), headers=FORM)
    assert (answer.status_code, answer.json()["view"]["filename"]) == (201, "a.jpg")


def test_a_part_without_a_name_is_malformed(client: CheckedClient) -> None:
    answer = client.post("/enroll", content=multipart(("X-Nothing: 1", photo())), headers=FORM)
    assert code(answer) == "malformed-body"


def test_an_empty_image_part_is_no_image(client: CheckedClient) -> None:
    answer = client.post("/enroll", content=multipart((IMAGE, b"")), headers=FORM)
    assert (answer.status_code, code(answer)) == (400, "no-picture")


def test_a_file_in_another_part_than_image_is_named(client: CheckedClient) -> None:
    answer = client.post("/enroll", files=[("photo", ("a.jpg", photo(), "image/jpeg"))])
    assert code(answer) == "invalid-parameter"
    assert answer.json()["errors"] == [
        {"parameter": "photo", "detail": "is a file; images are sent as parts named image"}
    ]


def test_a_part_that_is_no_utf8_and_one_that_is_too_long_are_listed(client: CheckedClient) -> None:
    body = multipart(
        (IMAGE, photo()),
        ('Content-Disposition: form-data; name="place"', b"\xff\xfe"),
        ('Content-Disposition: form-data; name="metadata"', b"x" * 70_000),
    )
    answer = client.post("/enroll", content=body, headers=FORM)
    assert [e["parameter"] for e in answer.json()["errors"]] == ["place", "metadata"]


def test_too_many_parts_are_refused(client: CheckedClient) -> None:
    body = multipart(*[('Content-Disposition: form-data; name="a"', b"")] * 400)
    assert code(client.post("/enroll", content=body, headers=FORM)) == "malformed-body"
    body = multipart(*[(IMAGE, b"x")] * 150)
    assert code(client.post("/enroll", content=body, headers=FORM)) == "invalid-parameter"


def test_a_body_larger_than_allowed_is_refused_by_its_announcement_and_by_its_count(
    client: CheckedClient, recogniser: FakeRecogniser
) -> None:
    announced = client.post("/enroll", content=bytes(2_000_001), headers={"content-type": "image/jpeg"})
    assert (announced.status_code, code(announced)) == (413, "body-too-large")
    assert "2,000,001 bytes; at most 2,000,000" in announced.json()["detail"]

    chunked = client.post("/enroll", content=(bytes(100_000) for _ in range(21)))
    assert (chunked.status_code, code(chunked)) == (413, "body-too-large")
    assert not recogniser.kept


@pytest.mark.parametrize("coding", ["gzip", "x-gzip", "DEFLATE", "identity, br"])
def test_a_packed_body_is_told_to_be_packed(client: CheckedClient, coding: str) -> None:
    for method, path, body in (("POST", "/enroll", photo()), ("PATCH", "/views/x", b"{}")):
        refused = client.request(method, path, content=gzip.compress(body), headers={"content-encoding": coding})
        assert (refused.status_code, code(refused)) == (400, "malformed-body")
        assert "send it unpacked" in refused.json()["detail"]
    assert client.get("/views", headers={"content-encoding": coding}).status_code == 200
    plain = client.post("/enroll", content=photo(), headers={"content-encoding": "identity"})
    assert plain.status_code == 201


def test_a_connection_that_closes_within_the_body_is_not_answered_500(
    runtime: FakeRuntime, recogniser: FakeRecogniser
) -> None:
    messages: list[dict[str, Any]] = [
        {"type": "http.request", "body": photo()[:100], "more_body": True},
        {"type": "http.disconnect"},
    ]
    sent: list[Any] = []

    async def receive() -> dict[str, Any]:
        return messages.pop(0)

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {
        "type": "http",
        "method": "POST",
        "path": "/enroll",
        "raw_path": b"/enroll",
        "query_string": b"",
        "headers": [(b"content-type", b"image/jpeg")],
    }
    asyncio.run(runtime.app()(scope, receive, send))
    assert sent[0]["status"] == 400
    assert b"malformed-body" in sent[1]["body"]
    assert not recogniser.kept


ERRORS: list[tuple[dict[str, str], list[str]]] = [
    ({"x": "1"}, ["y"]),
    ({"z": "1"}, ["x", "y"]),
    ({"lat": "1"}, ["lon"]),
    ({"alt": "1"}, ["lat", "lon"]),
    ({"x": "1", "y": "1", "lat": "1", "lon": "1"}, ["x"]),
    ({"x": "nan", "y": "1"}, ["x"]),
    ({"x": "1e10", "y": "-1e308", "z": "1000000001"}, ["x", "y", "z"]),
    ({"lat": "1", "lon": "1", "alt": "-2e9"}, ["alt"]),
    ({"x": "inf", "y": "-Infinity"}, ["x", "y"]),
    ({"x": "a", "y": "1"}, ["x"]),
    ({"lat": "90.1", "lon": "-180.1"}, ["lat", "lon"]),
    ({"heading": "360.5"}, ["heading"]),
    ({"heading": "-1"}, ["heading"]),
    ({"captured_at": "2026-03-01T09:30:00"}, ["captured_at"]),
    ({"captured_at": "1700000000"}, ["captured_at"]),
    ({"captured_at": "2026-02-30T09:30:00Z"}, ["captured_at"]),
    ({"captured_at": "0001-01-01T00:00:00+14:00"}, ["captured_at"]),
    ({"captured_at": "2026-03-01T09:30:00 01:00"}, ["captured_at"]),
    ({"map": ""}, ["map"]),
    ({"map": ".hidden"}, ["map"]),
    ({"map": "a/b"}, ["map"]),
    ({"map": "a\n"}, ["map"]),
    ({"map": "a" * 65}, ["map"]),
    ({"place": ""}, ["place"]),
    ({"place": "a\x00b"}, ["place"]),
    ({"place": "a\x9b31mb"}, ["place"]),
    ({"place": "\u200b\ufeff \u3164"}, ["place"]),
    ({"place": "p" * 201}, ["place"]),
    ({"metadata": "no"}, ["metadata"]),
    ({"metadata": "[1]"}, ["metadata"]),
    ({"metadata": "null"}, ["metadata"]),
    ({"metadata": '{"a": NaN}'}, ["metadata"]),
    ({"metadata": '{"a": 1e999}'}, ["metadata"]),
    ({"metadata": '{"a": 1, "a": 2}'}, ["metadata"]),
    ({"metadata": '{"a": "\\ud800"}'}, ["metadata"]),
    ({"metadata": '{"a": "\\u0000"}'}, ["metadata"]),
    ({"metadata": '{"a": ' + "9" * 5000 + "}"}, ["metadata"]),
    ({"metadata": '{"a":' * 9 + "1" + "}" * 9}, ["metadata"]),
    ({"metadata": "[" * 16000}, ["metadata"]),
    ({"metadata": '{"a": "' + "x" * 16384 + '"}'}, ["metadata"]),
    ({"wait": "perhaps"}, ["wait"]),
    ({"colour": "red"}, ["colour"]),
    ({"top": "5"}, ["top"]),
    ({"image": "a.jpg"}, ["image"]),
]


@pytest.mark.parametrize(("attributes", "wrong"), ERRORS, ids=lambda value: str(value)[:40])
def test_a_parameter_that_cannot_be_used_is_named(
    client: CheckedClient, recogniser: FakeRecogniser, attributes: dict[str, str], wrong: list[str]
) -> None:
    answer = client.post("/enroll", content=photo(), params=attributes, headers={"content-type": "image/jpeg"})
    assert (answer.status_code, code(answer)) == (422, "invalid-parameter")
    assert sorted({e["parameter"] for e in answer.json()["errors"]}) == sorted(wrong)
    assert all(e["detail"] for e in answer.json()["errors"])
    assert not recogniser.kept


def test_all_mistakes_are_listed_at_once(client: CheckedClient) -> None:
    answer = client.post(
        "/enroll?colour=red&place=a&place=b",
        files=files(photo()),
        data={"x": "nan", "lat": "91", "heading": "400", "metadata": "{", "captured_at": "noon", "wait": "maybe"},
    )
    named = {e["parameter"] for e in answer.json()["errors"]}
    assert named >= {"colour", "place", "x", "lat", "heading", "metadata", "captured_at", "wait"}


def test_metadata_may_be_as_deep_and_as_large_as_promised(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    deep = '{"a":' * 8 + "1" + "}" * 8
    large = '{"a": "' + "x" * (16384 - 9) + '"}'
    for text in (deep, large):
        answer = client.post("/enroll", files=files(photo(len(text))), data={"metadata": text})
        assert answer.status_code == 201, answer.text


@pytest.mark.parametrize(
    ("error", "status", "retry"),
    [
        (Busy("1000 wait", 17), 429, "17"),
        (DiskFull("the disk is full"), 507, None),
        (NothingStatic("only cars"), 422, None),
        (RuntimeError("secret"), 500, None),
    ],
)
def test_an_error_of_the_use_case_becomes_its_problem(
    client: CheckedClient, recogniser: FakeRecogniser, error: Exception, status: int, retry: str | None
) -> None:
    recogniser.fails["enroll_one" if status != 500 else "enroll"] = error
    answer = client.post("/enroll", files=files(photo()))
    assert answer.status_code == status
    assert answer.headers.get("retry-after") == retry
    assert "secret" not in answer.text


def test_a_text_that_is_too_long_is_told_in_characters(client: CheckedClient) -> None:
    answer = client.post("/enroll", data={"place": "ü" * 201}, files={"image": photo()})
    assert answer.json()["detail"].startswith("place: needs at most 200 characters (got 'üüü")
