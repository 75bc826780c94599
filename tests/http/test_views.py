"""`/views` and the images of a view: list, show, correct, delete."""

from collections.abc import Callable
from datetime import UTC, datetime
from io import BytesIO
from typing import Any

import pytest
from PIL import Image as PilImage

from schemas.records import Filters, Position, ViewAttributes
from schemas.where import condition
from schemas.wire import View, rfc3339
from tests.http.fakes import FakeRecogniser
from tests.openapi import CheckedClient
from tests.sample_images import photo

UNKNOWN = "0195f2a4-7c1e-7b3a-9d52-000000000000"


COMPREFACE = "/compat/compreface/default/api/v1/recognition"


@pytest.fixture
def view(client: CheckedClient) -> str:
    attributes = {"place": "hall", "x": "1", "y": "2", "metadata": '{"camera": "front", "lens": {"mm": 4, "f": 2}}'}
    answer = client.post("/enroll", files={"image": photo()}, data=attributes | {"captured_at": "2026-03-01T09:30:00Z"})
    return str(answer.json()["view"]["id"])


def test_a_view_can_be_shown_listed_and_deleted(client: CheckedClient, view: str) -> None:
    seen = client.get(f"/views/{view}").json()
    assert seen["place"] == "hall"
    assert client.get("/views").json()["views"] == [seen]
    for link in seen["links"].values():
        assert client.get(link).status_code == 200
    assert client.delete(f"/views/{view}").json()["views"] == 1
    assert client.get(f"/views/{view}").status_code == 404


def test_a_list_takes_filters_order_and_pages(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    query = "map=m&state=failed&sort=-enrolled_at&limit=7&cursor=abc&place=hall&metadata.a=b"
    assert client.get(f"/views?{query}").status_code == 200
    assert recogniser.given == {
        "map": "m",
        "filters": Filters(place="hall", metadata={"a": "b"}),
        "state": "failed",
        "newest_first": True,
        "cursor": "abc",
        "limit": 7,
    }


@pytest.mark.parametrize(
    "query", ["limit=0", "limit=501", "sort=place", "state=odd", "map=a%20b", "cursor=", "words=tree", "top=1"]
)
def test_a_list_refuses_unknown_parameters(client: CheckedClient, query: str) -> None:
    answer = client.get(f"/views?{query}")
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["parameter"] == query.partition("=")[0]


@pytest.mark.parametrize("method", ["GET", "DELETE"])
def test_all_mistakes_of_a_url_are_listed_at_once(client: CheckedClient, method: str) -> None:
    query = (
        "map=.x&place=a&place=b&frame=geo&after=2026-01-02T00:00:00Z&before=2026-01-01T00:00:00Z&colour=red"
        "&exclude=a,,b&exclude=c&metadata.floor=1&metadata.floor=2"
    )
    answer = client.request(method, f"/views?{query}")
    assert answer.status_code == 422
    told = [f"{e['parameter']} {e['detail']}".partition(" (got")[0] for e in answer.json()["errors"]]
    known = {
        "GET": "after, before, cursor, exclude, exclude_last, frame, limit, map, metadata.KEY, near, place, sort, "
        "state, where, words",
        "DELETE": "after, all, before, exclude, exclude_last, frame, map, metadata.KEY, near, place, where",
    }
    assert sorted(told) == [
        "after is later than before: no view can fit",
        f"colour is unknown; known are {known[method]}",
        "exclude was given 2 times",
        "frame is of use only with near",
        "map needs 1 to 64 of A-Z, a-z, 0-9, dot, _ and -, the first a letter or digit",
        "metadata.floor was given 2 times",
        "place was given 2 times",
    ]


@pytest.mark.parametrize(
    ("path", "said"),
    [
        (
            "/maps/my map",
            "map: needs 1 to 64 of A-Z, a-z, 0-9, dot, _ and -, the first a letter or digit (got 'my map')",
        ),
        ("/views/v1/changes?since=a b", "since: needs 1 to 64 of A-Z, a-z, 0-9 and - (got 'a b')"),
    ],
)
def test_what_names_and_ids_may_have_is_said_in_words(client: CheckedClient, path: str, said: str) -> None:
    refused = client.get(path)
    assert (refused.status_code, refused.json()["detail"]) == (422, said)


def test_filters_that_are_lists_of_numbers_or_ids_arrive(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    assert client.get("/views?near=1,2.5,30&exclude=a,b&exclude_last=10&metadata.KEY=x").status_code == 200
    assert recogniser.given["filters"] == Filters(
        near=(1, 2.5, 30), exclude=("a", "b"), exclude_last=10, metadata={"KEY": "x"}
    )


def test_a_condition_arrives_and_one_that_cannot_be_is_told(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    where = '{"place": {"$prefix": "hall/"}, "$not": {"metadata.floor": {"$lt": 2}}}'
    assert client.get("/views", params={"where": where}).status_code == 200
    assert recogniser.given["filters"] == Filters(where=condition(where))
    assert client.post("/query", data={"where": where}, files={"image": photo()}).status_code == 404  # there is no map

    for half_a_character in (r'{"place": "\ud800"}', r'{"metadata.\udc00": {"$in": ["x"]}}'):
        refused = client.get("/views", params={"where": half_a_character})
        assert (refused.status_code, "half of a surrogate pair" in refused.json()["detail"]) == (422, True)
    assert client.get("/views", params={"where": r'{"place": "\ud83d\ude00"}'}).status_code == 200  # a whole one

    refused = client.get("/views", params={"where": '{"place": {"$like": "hall%"}}'})
    assert refused.status_code == 422
    assert "where: place: $like is no operator: $eq, $ne" in refused.json()["detail"]


@pytest.mark.parametrize(
    ("query", "wrong"),
    [
        ("", ["all", "map"]),
        ("map=default", ["all"]),
        ("map=default&frame=map", ["all", "frame"]),
        ("place=hall", ["map"]),
        ("map=default&all=false", ["all"]),
        ("map=default&all=true&place=hall", ["all"]),
        ("map=default&exclude_last=0", ["all"]),  # leaves out none: it would empty the map
        ("map=default&exclude_last=000", ["all"]),
        ("all=true", ["map"]),
        ("map=default&plaice=hall", ["all", "plaice"]),
    ],
)
def test_deleting_many_needs_a_map_and_a_filter_or_all(
    client: CheckedClient, recogniser: FakeRecogniser, view: str, query: str, wrong: list[str]
) -> None:
    answer = client.delete(f"/views?{query}")
    assert answer.status_code == 422
    assert {"plaice"} <= {e["parameter"] for e in answer.json()["errors"]} or sorted(
        e["parameter"] for e in answer.json()["errors"]
    ) == wrong
    assert view in recogniser.kept


def test_deleting_many_by_a_filter_and_all(client: CheckedClient, recogniser: FakeRecogniser, view: str) -> None:
    assert client.delete("/views?map=other&metadata.camera=front").json()["views"] == 0
    assert recogniser.given["filters"] == Filters(metadata={"camera": "front"})
    for but_the_newest in ("exclude_last=1", "exclude_last=0s", "exclude_last=0&place=hall"):
        assert client.delete(f"/views?map=other&{but_the_newest}").status_code == 200
    assert client.delete("/views?map=default&all=true").json()["views"] == 1


ATTRIBUTES = ViewAttributes(
    "hall",
    Position(x=1.0, y=2.0),
    datetime(2026, 3, 1, 9, 30, tzinfo=UTC),
    {"camera": "front", "lens": {"mm": 4, "f": 2}},
    "upload",
)


def attributes(**changes: Any) -> ViewAttributes:
    return ViewAttributes(**{**vars(ATTRIBUTES), **changes})


@pytest.mark.parametrize(
    ("patch", "expected"),
    [
        ({}, ATTRIBUTES),
        ({"place": "cellar"}, attributes(place="cellar")),
        ({"place": None}, attributes(place=None)),
        ({"position": {"heading": 90}}, attributes(position=Position(x=1.0, y=2.0, heading=90.0))),
        ({"position": {"x": 5.5, "z": 1}}, attributes(position=Position(x=5.5, y=2.0, z=1.0))),
        ({"position": None}, attributes(position=Position())),
        ({"x": 5.5, "z": 1}, attributes(position=Position(x=5.5, y=2.0, z=1.0))),
        ({"x": None, "y": None, "lat": 48, "lon": 11}, attributes(position=Position(lat=48.0, lon=11.0))),
        ({"lat": 48, "lon": 11, "position": None}, attributes(position=Position(lat=48.0, lon=11.0))),
        ({"heading": 360}, attributes(position=Position(x=1.0, y=2.0, heading=0.0))),
        (
            {"position": {"x": None, "y": None, "lat": 48, "lon": 11}},
            attributes(position=Position(lat=48.0, lon=11.0)),
        ),
        ({"captured_at": None}, attributes(captured_at=None)),
        ({"captured_at": "2026-01-01T01:00:00+01:00"}, attributes(captured_at=datetime(2026, 1, 1, tzinfo=UTC))),
        ({"metadata": {"camera": None, "lens": {"f": None}}}, attributes(metadata={"lens": {"mm": 4}})),
        ({"metadata": {"floor": 2}}, attributes(metadata={**ATTRIBUTES.metadata, "floor": 2})),
        ({"metadata": None}, attributes(metadata={})),
    ],
    ids=str,
)
def test_a_patch_changes_what_it_names_and_nothing_else(
    client: CheckedClient, recogniser: FakeRecogniser, view: str, patch: dict[str, Any], expected: ViewAttributes
) -> None:
    answer = client.patch(f"/views/{view}", json=patch, headers={"content-type": "application/merge-patch+json"})
    assert answer.status_code == 200, answer.text
    assert recogniser.kept[view].attributes == expected


@pytest.mark.parametrize(
    ("patch", "wrong"),
    [
        ({"id": "x"}, ["id"]),
        ({"state": "ready", "enrolled_at": None}, ["enrolled_at", "state"]),
        ({"place": 7}, ["place"]),
        ({"place": ""}, ["place"]),
        ({"position": 7}, ["position"]),
        ({"position": {"x": "1"}}, ["position.x"]),
        ({"position": {"x": None}}, ["position.x"]),
        ({"position": {"lat": 48, "lon": 11}}, ["position.x"]),
        ({"position": {"height": 3}}, ["position.height"]),
        ({"position": {"heading": 360.5}}, ["position.heading"]),
        ({"x": "1"}, ["x"]),
        ({"x": None}, ["x"]),
        ({"lat": 48, "lon": 11}, ["position.x"]),
        ({"x": 1, "position": {"y": 3}}, ["x"]),
        ({"filename": "b.jpg"}, ["filename"]),
        ({"captured_at": 17}, ["captured_at"]),
        ({"captured_at": "noon"}, ["captured_at"]),
        ({"metadata": []}, ["metadata"]),
        ({"metadata": '{"floor": 2}'}, ["metadata"]),
        ({"metadata": {"long": "x" * 17_000}}, ["metadata"]),
        ({"metadata": {"a": {"a": {"a": {"a": {"a": {"a": {"a": {"a": {"a": 1}}}}}}}}}}, ["metadata"]),
        ({"place": 7, "position": {"heading": -1}, "oops": 1}, ["oops", "place", "position.heading"]),
    ],
    ids=lambda value: str(value)[:50],
)
def test_a_patch_that_cannot_be_used_changes_nothing(
    client: CheckedClient, recogniser: FakeRecogniser, view: str, patch: dict[str, Any], wrong: list[str]
) -> None:
    answer = client.patch(f"/views/{view}", json=patch)
    assert answer.status_code == 422
    assert sorted(e["parameter"] for e in answer.json()["errors"]) == wrong
    assert recogniser.kept[view].attributes == ATTRIBUTES


@pytest.mark.parametrize(
    "body",
    [
        b"{",
        b"[1]",
        b'"x"',
        b'{"place": NaN}',
        b'{"a":1,"a":2}',
        b"\xff\xfe{}",
        b"[" * 9999,
        b'{"\\ud800": 1}',
        b'{"metadata": {"a": ["\\udfff"]}}',
        b'{"place": "\xed\xa0\x80"}',
    ],
)
def test_a_patch_that_is_no_json_object_is_malformed(client: CheckedClient, view: str, body: bytes) -> None:
    answer = client.patch(f"/views/{view}", content=body, headers={"content-type": "application/json"})
    assert (answer.status_code, answer.json()["type"]) == (400, "urn:revisit:problem:malformed-body")


def test_a_patch_has_a_size(client: CheckedClient, view: str) -> None:
    assert client.patch(f"/views/{view}", content=b" " * 300_000).status_code == 413


@pytest.mark.parametrize(
    "path",
    [
        *("image", "thumbnail", "thumbnail?size=32", "segmentation.png", "segmentation.png?overlay=true", "graph.png"),
        *("segmentation.png?overlay=true&legend=true", "graph.png?legend=true"),
    ],
)
def test_images_are_cached_by_their_etag(client: CheckedClient, view: str, path: str) -> None:
    first = client.get(f"/views/{view}/{path}")
    assert first.status_code == 200
    etag = first.headers["etag"]
    assert "no-cache" in first.headers["cache-control"]
    for given in (etag, f"W/{etag}", f'"other", {etag}', "*"):
        again = client.get(f"/views/{view}/{path}", headers={"if-none-match": given})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", etag)
    assert client.get(f"/views/{view}/{path}", headers={"if-none-match": '"other"'}).status_code == 200


def test_options_of_an_image_have_etags_of_their_own(client: CheckedClient, view: str) -> None:
    paths = ["thumbnail", "thumbnail?size=32", "segmentation.png", "segmentation.png?overlay=1", "graph.png", "image"]
    paths += ["segmentation.png?overlay=1&legend=1", "graph.png?legend=1"]
    assert len({client.get(f"/views/{view}/{path}").headers["etag"] for path in paths}) == len(paths)


def test_the_image_comes_back_byte_for_byte_and_the_thumbnail_small(client: CheckedClient, view: str) -> None:
    image = client.get(f"/views/{view}/image")
    assert (image.content, image.headers["content-type"]) == (photo(), "image/jpeg")
    assert image.headers["x-content-type-options"] == "nosniff"
    assert image.headers["content-disposition"] == f'inline; filename="{view}.jpeg"'
    assert PilImage.open(BytesIO(client.get(f"/views/{view}/thumbnail?size=32").content)).size == (32, 24)


def test_a_legend_is_an_option_of_drawings(client: CheckedClient, view: str) -> None:
    for path, plain in (("segmentation.png?overlay=true", b"overlay"), ("graph.png", b"graph")):
        option = "&" if "?" in path else "?"
        assert client.get(f"/views/{view}/{path}").content == plain
        assert client.get(f"/views/{view}/{path}{option}legend=false").content == plain
        assert client.get(f"/views/{view}/{path}{option}legend=true").content == plain + b" with legend"
    refused = client.get(f"/views/{view}/segmentation.png?legend=true")
    assert refused.status_code == 422
    assert refused.json()["errors"] == [{"parameter": "legend", "detail": "is of use only with overlay=true"}]


def test_a_drawing_names_the_network_that_it_is_of(client: CheckedClient, view: str) -> None:
    drawn = {path: client.get(f"/views/{view}/{path}").headers for path in ("segmentation.png", "graph.png")}
    assert {path: of["revisit-drawn-by"] for path, of in drawn.items()} == {
        "segmentation.png": "segmenter",
        "graph.png": "encoder",
    }
    assert "revisit-drawn-by" not in client.get(f"/views/{view}/image").headers


@pytest.mark.parametrize("path", ["thumbnail?size=8", "thumbnail?size=9999", "segmentation.png?overlay=2", "image?x=1"])
def test_an_image_route_refuses_unknown_options(client: CheckedClient, view: str, path: str) -> None:
    assert client.get(f"/views/{view}/{path}").status_code == 422


def test_a_time_of_long_ago_is_answered_as_it_was_sent() -> None:
    assert rfc3339(datetime(208, 4, 22, 10, 50, tzinfo=UTC)) == "0208-04-22T10:50:00.000000Z"


def test_a_subject_is_renamed_though_an_example_of_it_is_deleted_or_moved_meanwhile(
    client: CheckedClient, recogniser: FakeRecogniser, view: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone, moved = (
        str(client.post("/enroll", files={"image": photo(seed)}, data={"place": "hall"}).json()["view"]["id"])
        for seed in (1, 2)
    )
    patch = recogniser.patch_view

    async def others_are_quicker(view_id: str, change: Callable[[ViewAttributes], ViewAttributes]) -> View:
        recogniser.kept.pop(gone, None)
        recogniser.kept[moved].attributes = ViewAttributes(place="yard")
        return await patch(view_id, change)

    monkeypatch.setattr(recogniser, "patch_view", others_are_quicker)

    renamed = client.put(f"{COMPREFACE}/subjects/hall", json={"subject": "foyer"})

    assert (renamed.status_code, renamed.json()) == (200, {"updated": True})
    assert {kept.id: kept.attributes.place for kept in recogniser.kept.values()} == {view: "foyer", moved: "yard"}


@pytest.mark.parametrize("method", ["PUT", "DELETE"])
def test_an_encoded_slash_at_the_end_belongs_to_the_name(
    client: CheckedClient, recogniser: FakeRecogniser, view: str, method: str
) -> None:
    """The place `hall/` is not `hall`, which must neither be renamed nor deleted in its stead."""
    sent = {"json": {"subject": "foyer"}} if method == "PUT" else {}
    assert client.request(method, f"{COMPREFACE}/subjects/hall%2F", **sent).status_code == 200
    assert recogniser.given["filters"].place == "hall/"
