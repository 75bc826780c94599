"""Repeated and unknown parameters, and bodies where none is taken, are refused by every route of the document."""

import re
from collections.abc import Iterator

import pytest

from tests.http.document import document
from tests.openapi import UNDOCUMENTED, CheckedClient
from tests.sample_images import photo

DOCUMENT = document()
OPERATIONS = [(method, path) for path, methods in DOCUMENT["paths"].items() for method in methods] + [
    ("get", path) for path in UNDOCUMENTED
]
TAKES_IMAGES = [("post", "/enroll"), ("post", "/query")]
WITHOUT_BODY = [
    (method, path)
    for method, path in OPERATIONS
    if "requestBody" not in DOCUMENT["paths"].get(path, {}).get(method, {})
]


def address(path: str) -> str:
    return re.sub(r"\{\w+\}", "some", path)


def known(method: str, path: str) -> list[str]:
    """The names of an operation's parameters in the URL."""
    parameters = DOCUMENT["paths"].get(path, {}).get(method, {}).get("parameters", [])
    return [one["name"].replace("KEY", "floor") for one in parameters if one["in"] == "query"]


def test_the_table_has_all_kinds_of_routes() -> None:
    assert len(OPERATIONS) > 25
    assert ("post", "/maps/{map}/vocabulary") in WITHOUT_BODY
    assert ("put", "/maps/{map}") not in WITHOUT_BODY


@pytest.mark.parametrize(("method", "path"), OPERATIONS)
def test_unknown_and_repeated_parameters_are_named(client: CheckedClient, method: str, path: str) -> None:
    body = {"content": photo(), "headers": {"content-type": "image/jpeg"}} if (method, path) in TAKES_IMAGES else {}
    for name in ("odd", *known(method, path)):
        answer = client.request(method, f"{address(path)}?{name}=1&{name}=1", **body)
        assert (answer.status_code, answer.json()["type"]) == (422, "urn:revisit:problem:invalid-parameter"), name
        named = [error["parameter"] for error in answer.json()["errors"] if "2 times" in error["detail"]]
        assert named == [name]
    answer = client.request(method, f"{address(path)}?odd=1", **body)
    assert answer.status_code == 422
    assert "odd" in {error["parameter"] for error in answer.json()["errors"]}


@pytest.mark.parametrize(("method", "path"), TAKES_IMAGES)
def test_repeated_parts_are_named(client: CheckedClient, method: str, path: str) -> None:
    for name in known(method, path):
        parts = [("image", ("a.jpg", photo())), (name, (None, "1")), (name, (None, "1"))]
        answer = client.request(method, path, files=parts)
        assert answer.status_code == 422
        assert any("2 times" in error["detail"] for error in answer.json()["errors"]), (name, answer.text)


def test_a_number_with_an_underscore_is_none(client: CheckedClient) -> None:
    """Python alone reads 12_5 as 125; it is 12.5 that was meant."""
    numbers = {"x": "12_5", "y": "1_0"}
    answer = client.post("/enroll", files={"image": photo()}, data={**numbers, "place": "hall_1", "map": "floor_1"})
    assert {error["parameter"] for error in answer.json()["errors"]} == set(numbers)

    numbers = {"near": "1_0,2,30", "top": "1_0", "precision": "0.9_7"}
    answer = client.post("/query", files={"image": photo()}, data={**numbers, "map": "floor_1"})
    assert {error["parameter"] for error in answer.json()["errors"]} == set(numbers)
    assert "no number has (got '1_0')" in answer.json()["detail"]


@pytest.mark.parametrize("coding", ["base64", "Quoted-Printable", "x-own"])
def test_a_part_that_would_have_to_be_decoded_is_refused(client: CheckedClient, coding: str) -> None:
    for name, (filename, content) in {"place": (None, "aGFsbA=="), "image": ("a.jpg", photo())}.items():
        said = {"Content-Transfer-Encoding": coding}
        parts = {"image": ("a.jpg", photo()), name: (filename, content, "text/plain", said)}
        answer = client.post("/enroll", files=parts)
        assert (answer.status_code, answer.json()["type"]) == (400, "urn:revisit:problem:malformed-body")
        assert f"the part `{name}` is encoded" in answer.json()["detail"]


@pytest.mark.parametrize("coding", ["binary", "8bit", " 7BIT"])
def test_a_part_that_says_that_it_is_as_it_is_is_taken(client: CheckedClient, coding: str) -> None:
    said = {"Content-Transfer-Encoding": coding}
    parts = {"image": ("a.jpg", photo(), "image/jpeg", said), "place": (None, "hall", "text/plain", said)}
    answer = client.post("/enroll", files=parts)
    assert answer.json()["view"]["place"] == "hall"


def chunks(*pieces: bytes) -> Iterator[bytes]:
    yield from pieces


@pytest.mark.parametrize(("method", "path"), WITHOUT_BODY)
def test_a_body_where_none_is_taken_is_refused(client: CheckedClient, method: str, path: str) -> None:
    for body in (b"{}", chunks(b"", b"x"), chunks(b"x" * 100_000)):
        answer = client.request(method, address(path), content=body)
        assert (answer.status_code, answer.json()["type"]) == (400, "urn:revisit:problem:unexpected-body")


@pytest.mark.parametrize(("method", "path"), WITHOUT_BODY)
def test_an_empty_body_is_none(client: CheckedClient, method: str, path: str) -> None:
    for body in (b"", chunks(b"")):
        answer = client.request(method, address(path), content=body, headers={"content-type": "application/json"})
        assert answer.status_code in (200, 202, 404, 409, 422), answer.text


def test_all_operations_promise_the_refusals() -> None:
    for methods in DOCUMENT["paths"].values():
        for operation in methods.values():
            assert {"400", "408", "422", "431"} <= operation["responses"].keys()


def test_parameters_that_are_not_utf_8_are_named(client: CheckedClient) -> None:
    """No bytes become other characters: a place would be kept under a name that nobody gave it."""
    for method, path in OPERATIONS:
        for query, name in (("place=%ff%fe", "place"), ("map=a&place=caf%E9", "place"), ("%E9t%E9=1", "\ufffdt\ufffd")):
            answer = client.request(method, f"{address(path)}?{query}")
            assert (answer.status_code, answer.json()["type"]) == (422, "urn:revisit:problem:invalid-parameter")
            assert [error["parameter"] for error in answer.json()["errors"]] == [name]


@pytest.mark.parametrize(
    "address",
    [
        "/views?" + "&".join(f"a{number}=" for number in range(9000)),
        "/views?" + "&".join(f"a{number}=&a{number}=" for number in range(4500)),
        "/maps?" + "&".join(f"a{number}=" for number in range(9000)),
    ],
)
def test_thousands_of_mistakes_are_told_by_the_first_hundred(client: CheckedClient, address: str) -> None:
    """All of them were megabytes, whose writing held up everybody else for a second."""
    answer = client.get(address)
    assert answer.status_code == 422
    assert len(answer.json()["errors"]) == 100
    assert answer.json()["detail"].endswith("; and more")
    assert len(answer.content) < 100_000
