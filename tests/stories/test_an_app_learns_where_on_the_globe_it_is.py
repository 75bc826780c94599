"""An app that speaks GeoPose is told where it is, by both protocols, and what it sends is not kept."""

import base64
import json
from pathlib import Path

import httpx
import pytest

from scenes import scene
from tests.stories.photos import photo
from tests.stories.running import ROOT, RunningService
from tests.stories.shown import answers_of

pytestmark = pytest.mark.one_database("a protocol over a query; tests/storage reads from both which views are near")

NAMES = ("mill lane", "the green", "school hill", "chapel row", "the quay", "north gate")
OSCP = {"accept": "application/vnd.oscp+json;version=2.0"}


def localization(image: bytes, lat: float) -> dict[str, object]:
    camera = {"imageBytes": base64.b64encode(image).decode(), "privacy": {"dataRetention": ["none"]}}
    near = {"latitude": lat, "longitude": 14.0, "accuracy": 10.0}
    return {
        "id": "a1",
        "timestamp": 1,
        "type": "geopose",
        "sensors": [{"id": "0", "type": "camera"}],
        "sensorReadings": {"cameraReadings": [camera], "geolocationReadings": [near]},
    }


def test_where_on_the_globe(tmp_path: Path) -> None:
    with (
        # Not comparing: a level learnt between two queries would change the probability of the second.
        RunningService(tmp_path, REVISIT_ENCODER="compact", REVISIT_COMPARE="false") as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):
        for number, name in enumerate(NAMES):
            where = {"place": name, "lat": 50 + number / 10000, "lon": 14.0, "alt": 190, "heading": 60}
            client.post(
                "/enroll", data=where | {"map": "campus"}, files={"image": photo(scene(name).seen_from())}
            ).raise_for_status()
        client.patch("/maps/campus", json={"keep_queries": 10}).raise_for_status()
        here, elsewhere = photo(scene("chapel row").seen_from(dx=0.3, turn=2)), photo(scene("elsewhere").seen_from())

        pose = client.post("/query?map=campus", files={"image": here}, headers={"accept": "application/geopose+json"})
        found = client.post("/localize/geopose?map=campus", json=localization(here, 50.0003), headers=OSCP)
        lost = client.post("/localize/geopose?map=campus", json=localization(elsewhere, 50.0003), headers=OSCP)
        without = localization(elsewhere, 50.0)
        without["sensorReadings"].pop("geolocationReadings")  # type: ignore[attr-defined]
        client.post("/localize/geopose?map=campus", json=without, headers=OSCP)
        unknown = client.get("/maps/campus/unknown").json()
        (tmp_path / "today.jpg").write_bytes(here)
        basic, _, oscp = (
            json.loads(answer or "{}") for answer in answers_of(ROOT / "docs" / "geopose.md", tmp_path, service.url)
        )

    assert pose.headers["content-type"] == "application/geopose+json"
    assert pose.json()["position"]["lat"] == pytest.approx(50.0003, abs=1e-4)
    assert pose.json()["position"]["h"] == pytest.approx(190)
    assert pose.json()["angles"]["yaw"] == 30
    assert pose.json()["accuracy"]["position"] >= 5
    assert found.status_code == 200, found.text
    assert found.json()["id"] == "a1"
    assert found.json()["geopose"]["position"] == pytest.approx(pose.json()["position"], abs=1e-4)
    assert (lost.status_code, set(lost.json())) == (404, {"ERROR"})
    assert unknown["places"] == []
    assert basic == pose.json()
    assert oscp["id"] == "7"
    assert oscp["geopose"]["quaternion"] == pytest.approx({"x": 0, "y": 0, "z": 0.2588, "w": 0.9659}, abs=1e-4)
