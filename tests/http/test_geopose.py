"""Poses on the globe: the arithmetic, and the two protocols over HTTP."""

import base64
import math
from typing import Any

import pytest
from hypothesis import given, strategies as st

from app.http import geopose
from schemas.errors import InvalidParameters, NoPose
from schemas.wire import QueryAnswer
from tests import answers
from tests.http.fakes import FakeRecogniser
from tests.openapi import CheckedClient
from tests.sample_images import photo

OSCP = {"accept": geopose.OSCP_VERSION}


def answer(status: str = "matched", *, heading: float | None = 60.0, radius: float | None = 3.5) -> QueryAnswer:
    """An answer whose place lies on the globe."""
    at = {"x": None, "y": None, "z": None, "lat": 50.0, "lon": 14.0, "alt": None, "heading": heading}
    estimate: dict[str, Any] = {"position": at | {"heading": None}, "radius_m": radius, "views": []}
    return QueryAnswer.model_validate(
        answers.query_answer(answers.match(position=at), status=status) | {"estimate": estimate}
    )


@pytest.mark.parametrize(("heading", "yaw"), [(0, 90), (90, 0), (180, -90), (270, 180), (30, 60), (359, 91)])
def test_yaw_is_counted_from_east_the_other_way_round(heading: float, yaw: float) -> None:
    assert geopose.yaw_of(heading) == yaw


@given(st.floats(0, 359.999))
def test_a_quaternion_turns_east_to_where_the_camera_looks(heading: float) -> None:
    q = geopose.quaternion_of(geopose.yaw_of(heading))
    # The first column of the rotation's matrix: where the axis that pointed east points now.
    east, north = 1 - 2 * q["z"] ** 2, 2 * q["w"] * q["z"]
    assert -180 < geopose.yaw_of(heading) <= 180
    assert (east, north) == pytest.approx((math.sin(math.radians(heading)), math.cos(math.radians(heading))), abs=1e-9)


def test_a_sure_answer_is_a_pose() -> None:
    assert geopose.basic_ypr(answer()) == {
        "position": {"lat": 50.0, "lon": 14.0, "h": 0.0},
        "angles": {"yaw": 30.0, "pitch": 0.0, "roll": 0.0},
        "accuracy": {"position": 3.5, "orientation": 20.0},
        "confidence": 0.93,
    }


def test_what_is_not_known_is_not_claimed() -> None:
    assert geopose.basic_ypr(answer(heading=None, radius=None))["accuracy"] == {"position": None, "orientation": 180.0}


@pytest.mark.parametrize("status", ["ambiguous", "no_match"])
def test_nothing_sure_is_no_pose(status: str) -> None:
    with pytest.raises(NoPose, match="do this"):
        geopose.basic_ypr(answer(status))


def test_metres_are_no_pose() -> None:
    with pytest.raises(NoPose, match="lat and lon"):
        geopose.basic_ypr(QueryAnswer.model_validate(answers.query_answer(answers.match())))


@pytest.mark.parametrize(
    ("accept", "wanted"),
    [
        ("", False),
        ("*/*", False),
        ("application/json", False),
        ("application/geopose+json", True),
        ("application/geopose+json, application/json;q=0.5", True),
        ("application/geopose+json;q=0.5, application/json", False),
        ("application/geopose+json;q=inf, application/json", False),
        ("application/geopose+json;q=x", False),
    ],
)
def test_who_asks_for_a_pose(accept: str, wanted: bool) -> None:
    assert geopose.wants_geopose(accept) is wanted


@pytest.mark.parametrize(
    ("accept", "spoken"),
    [
        ("application/vnd.oscp+json;version=2.0", True),
        ("application/vnd.oscp+json; version=2.0", True),
        ("text/html, application/vnd.oscp+json;version=2.0;q=0.9", True),
        ('application/vnd.oscp+json; charset=utf-8; version="2.0"', True),
        ("application/vnd.oscp+json;version=2.0;q=0", False),
        ("application/vnd.oscp+json;version=2.0;q=0.00", False),
        ("application/vnd.oscp+json;version=2.0;q=0.001", True),
        ("application/vnd.oscp+json;version=2.0;q=nan", False),
        ("application/vnd.oscp+json;version=1.0", False),
        ("application/vnd.oscp+json", False),
        ("*/*", False),
    ],
)
def test_which_version_is_spoken(accept: str, spoken: bool) -> None:
    assert geopose.speaks_oscp(accept) is spoken


def request(**changes: Any) -> dict[str, Any]:
    """A request as apps send it."""
    camera = {
        "timestamp": 1767225600000,
        "sensorId": "0",
        "privacy": {"dataRetention": [], "dataAcceptableUse": []},
        "sequenceNumber": 0,
        "imageFormat": "RGBA32",
        "size": [64, 48],
        "imageBytes": base64.b64encode(photo()).decode(),
        "imageOrientation": {"mirrored": False, "rotation": 0},
    }
    return {
        "id": "8f6e6e1e",
        "timestamp": 1767225600000,
        "type": "geopose",
        "sensors": [{"id": "0", "type": "camera"}],
        "sensorReadings": {"cameraReadings": [camera | changes.pop("camera", {})], **changes.pop("readings", {})},
    } | changes


PRIOR = {"id": "a", "geopose": {"position": {"lat": 50.1, "lon": 14.1, "h": 0}}, "accuracy": {"position": 60.0}}
FIX = {"latitude": 50.2, "longitude": 14.2, "accuracy": 5.0, "altitude": 3}


def test_the_last_prior_says_where_to_look() -> None:
    read = geopose.GeoPoseRequest.model_validate

    assert read(request()).near() is None
    assert read(request(readings={"geolocationReadings": [FIX]})).near() == (50.2, 14.2, 100.0)
    assert read(request(readings={"geolocationReadings": [FIX]}, priorPoses=[PRIOR])).near() == (50.1, 14.1, 180.0)


def test_an_answer_is_a_prior_of_the_next_request() -> None:
    read = geopose.GeoPoseRequest.model_validate
    sure, vague = (geopose.oscp_answer("a", 1, answer(radius=radius)) for radius in (50.0, None))

    assert read(request(priorPoses=[sure])).near() == (50.0, 14.0, 150.0)
    assert vague["accuracy"]["position"] is None
    assert read(request(priorPoses=[vague])).near() == (50.0, 14.0, 100.0)
    assert read(request(priorPoses=[vague["geopose"]] * 500)).near() == (50.0, 14.0, 100.0)


def test_a_prior_of_any_accuracy_says_nothing() -> None:
    """The protocol's own library sends the largest number that there is where it knows none."""
    read = geopose.GeoPoseRequest.model_validate
    largest = {"position": 1.7976931348623157e308, "orientation": 1.7976931348623157e308}

    assert read(request(priorPoses=[PRIOR | {"accuracy": largest}])).near() is None
    assert read(request(readings={"geolocationReadings": [FIX | {"accuracy": 1e7}]})).near() == (50.2, 14.2, 3e7)


def test_null_is_nothing() -> None:
    read = geopose.GeoPoseRequest.model_validate
    nothing = request(
        camera={"imageOrientation": None, "privacy": None}, readings={"geolocationReadings": None}, priorPoses=None
    )

    assert read(nothing).near() is None
    assert read(nothing).may_be_kept()
    assert read(nothing).image() == photo()
    assert read(request(priorPoses=[PRIOR | {"accuracy": None}])).near() == (50.1, 14.1, 100.0)


@pytest.mark.parametrize("camera", [{"imageBytes": "no base64!"}, {"imageOrientation": {"rotation": 90}}])
def test_an_image_that_cannot_be_read_is_refused(camera: dict[str, Any]) -> None:
    with pytest.raises(InvalidParameters):
        geopose.GeoPoseRequest.model_validate(request(camera=camera)).image()


def test_a_request_is_a_query_whose_image_is_not_kept(client: CheckedClient, recogniser: FakeRecogniser) -> None:
    client.post("/enroll?map=campus", content=photo(), headers={"content-type": "image/jpeg"})

    sent = client.post("/localize/geopose?map=campus&precision=0.99", json=request(priorPoses=[PRIOR]), headers=OSCP)

    assert sent.status_code == 404  # the fake's places have no lat and lon
    assert list(sent.json()) == ["ERROR"]
    assert sent.json()["ERROR"].endswith("lack lat and lon: enrol them with both")
    assert sent.headers["content-type"] == geopose.OSCP_VERSION
    assert (recogniser.given["map"], recogniser.given["precision"]) == ("campus", 0.99)
    assert recogniser.given["keep"] is False
    assert recogniser.given["filters"].near == (50.1, 14.1, 180.0)
    assert recogniser.given["filters"].geographic is True


@pytest.mark.parametrize("many", [{"priorPoses": [0] * 150_000}, {"readings": {"geolocationReadings": [{}] * 90_000}}])
def test_many_readings_are_refused_in_few_words(client: CheckedClient, many: dict[str, Any]) -> None:
    answered = client.post("/localize/geopose", json=request(**many), headers=OSCP)

    assert (answered.status_code, answered.json()["type"]) == (422, "urn:revisit:problem:invalid-parameter")
    assert len(answered.content) < 1_000_000


@pytest.mark.parametrize("path", ["/localize/geopose", "/compat/compreface/m/api/v1/recognition/recognize"])
def test_a_body_of_very_many_values_is_refused_unread(client: CheckedClient, path: str) -> None:
    """Each fills memory, and takes a while: of a body of one image there are few."""
    body = b'{"priorPoses": [' + b"{}," * 200_000 + b"{}]}"
    answered = client.post(path, content=body, headers={**OSCP, "content-type": "application/json"})

    assert (answered.status_code, answered.json()["type"]) == (400, "urn:revisit:problem:malformed-body")
    assert "200,000 values" in answered.json()["detail"]


def test_another_version_is_a_bad_request(client: CheckedClient) -> None:
    for headers in ({"accept": "application/json"}, {"accept": "application/vnd.oscp+json;version=1.0"}):
        answered = client.post("/localize/geopose", json=request(), headers=headers)
        assert (answered.status_code, answered.json()["type"]) == (400, "urn:revisit:problem:bad-request")
        assert answered.json()["ERROR"] == answered.json()["detail"]


@pytest.mark.parametrize(
    ("body", "named"),
    [
        ({}, "id"),
        ({"id": "a", "sensorReadings": {"cameraReadings": []}}, "sensorReadings.cameraReadings"),
        (request(camera={"imageBytes": "%"}), "sensorReadings.cameraReadings.0.imageBytes"),
        (request(priorPoses=[{"geopose": {"position": {"lat": 99, "lon": 0}}}]), "priorPoses.0.geopose.position.lat"),
        (request(priorPoses=[{"position": {"lat": 0, "lon": 181}}]), "priorPoses.0.geopose.position.lon"),
        (request(priorPoses=[{"geopose": {"position": {"lat": True, "lon": 0}}}]), "priorPoses.0.geopose.position.lat"),
        (request(priorPoses=[{"geopose": {"position": {"lat": "5", "lon": 0}}}]), "priorPoses.0.geopose.position.lat"),
        (
            request(priorPoses=[{"geopose": {"position": {"lat": 10**400, "lon": 0}}}]),
            "priorPoses.0.geopose.position.lat",
        ),
        (request(priorPoses=[PRIOR | {"accuracy": {"position": -1}}]), "priorPoses.0.accuracy.position"),
        (request(priorPoses={}), "priorPoses"),
        (request(type="localize"), "type"),
        (request(id=5), "id"),
        (request(camera={"imageBytes": None}), "sensorReadings.cameraReadings.0.imageBytes"),
        (
            request(camera={"imageOrientation": {"mirrored": "no"}}),
            "sensorReadings.cameraReadings.0.imageOrientation.mirrored",
        ),
    ],
)
def test_what_is_wrong_with_a_request_is_named(client: CheckedClient, body: dict[str, Any], named: str) -> None:
    refused = client.post("/localize/geopose", json=body, headers=OSCP)

    assert refused.status_code == 422
    assert named in [one["parameter"] for one in refused.json()["errors"]]
    assert refused.json()["ERROR"] == refused.json()["detail"]


@pytest.mark.parametrize("body", [b"{", b"[1]", b'{"id": NaN}', b'{"a": 1e400}', b'{"a":' * 50_000])
def test_what_is_no_json_is_refused(client: CheckedClient, body: bytes) -> None:
    refused = client.post("/localize/geopose", content=body, headers=OSCP)

    assert (refused.status_code, refused.json()["type"]) == (400, "urn:revisit:problem:malformed-body")
    assert refused.json()["ERROR"] == refused.json()["detail"]


def test_no_image_is_no_image(client: CheckedClient) -> None:
    refused = client.post("/localize/geopose", json=request(camera={"imageBytes": ""}), headers=OSCP)

    assert (refused.status_code, refused.json()["type"]) == (400, "urn:revisit:problem:no-picture")


def test_what_is_no_image_is_refused_as_everywhere(client: CheckedClient) -> None:
    text = base64.b64encode(b"%PDF-1.7").decode()

    refused = client.post("/localize/geopose", json=request(camera={"imageBytes": text}), headers=OSCP)

    assert (refused.status_code, refused.json()["type"]) == (415, "urn:revisit:problem:not-a-picture")


def test_accept_may_be_sent_twice(client: CheckedClient) -> None:
    """As where a library has one of its own: both are one list (RFC 9110, 5.3)."""
    plain = ("accept", "text/html")
    client.post("/enroll", content=photo(), headers={"content-type": "image/jpeg"})

    ogc = [plain, ("accept", geopose.OGC), ("content-type", "image/jpeg")]
    assert client.post("/query", content=photo(), headers=ogc).json()["type"] == "urn:revisit:problem:no-pose"
    oscp = [plain, ("accept", geopose.OSCP_VERSION)]
    assert client.post("/localize/geopose", json=request(), headers=oscp).json().keys() == {"ERROR"}


def test_a_query_without_a_pose_says_why(client: CheckedClient) -> None:
    headers = {"accept": "application/geopose+json", "content-type": "image/jpeg"}

    client.post("/enroll", content=photo(), headers=headers)

    refused = client.post("/query", content=photo(), headers=headers)

    assert (refused.status_code, refused.json()["type"]) == (404, "urn:revisit:problem:no-pose")
