"""`GET /maps/{map}/health`: an owner asks what makes answers wrong or missing, follows the advice, and asks again."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from app.http.application import create_app
from tests.openapi import CheckedClient
from tests.sample_images import drawn, encoded
from tests.stories.running import settings
from worker.runtime import Runtime, build

JPEG = {"content-type": "image/jpeg"}


class Site:
    """A service and its map ``site``."""

    def __init__(self, runtime: Runtime, client: CheckedClient) -> None:
        self.runtime, self.client = runtime, client

    def enroll(self, seed: int, quality: int = 95, **attributes: Any) -> str:
        """The id of a view of a drawn place."""
        params = {"map": "site", **attributes}
        image = encoded(drawn(320, 240, seed), "jpeg", quality=quality)
        answer = self.client.post("/enroll", params=params, content=image, headers=JPEG)
        assert answer.status_code == 201, answer.text
        return str(answer.json()["view"]["id"])

    def health(self, **params: Any) -> Any:
        answer = self.client.get("/maps/site/health", params=params)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def found(self, code: str) -> Any:
        return self.health(code=code)["findings"]


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    runtime = build(settings(tmp_path, compare=False))
    with CheckedClient(create_app(runtime)) as client:
        yield Site(runtime, client)


def test_two_rooms_that_look_alike_are_twins_until_they_are_one_place(site: Site) -> None:
    for seed in range(5):
        site.enroll(seed, place=f"room {seed}", x=100 * seed, y=0)
    first = site.enroll(50, place="office 1", x=0, y=900)
    second = site.enroll(50, quality=70, place="office 2", x=0, y=1000)
    assert (site.health()["compared"], site.found("twins")) == (0, [])

    site.runtime.comparer.all()

    health = site.health()
    assert (health["views"], health["examined"], health["compared"]) == (7, 7, 7)
    [twins] = site.found("twins")
    assert twins["places"] == ["office 1", "office 2"]
    assert set(twins["views"]) == {first, second}
    assert "'office 1' and 'office 2'" in twins["detail"]
    assert "PATCH" in twins["remedy"]

    site.client.patch(f"/views/{second}", json={"place": "office 1"})
    site.runtime.comparer.all()
    assert site.found("twins") == []


def test_the_same_photo_twice_adds_nothing_and_under_two_names_is_a_mistake(site: Site) -> None:
    site.enroll(0, place="gate")
    kept = site.enroll(1, place="yard")
    again = [site.enroll(1, quality=quality, place="yard") for quality in (80, 70)]
    wrong = [site.enroll(2, place="hall"), site.enroll(2, quality=75, place="stairs")]

    contradiction, duplicates = site.found("duplicates")

    assert (contradiction["views"], contradiction["places"]) == (wrong, ["hall", "stairs"])
    assert (duplicates["views"], duplicates["count"]) == ([kept, *again], 3)
    assert kept in duplicates["remedy"]
    for view in again:
        site.client.delete(f"/views/{view}")
    site.client.delete(f"/views/{wrong[1]}")
    assert site.found("duplicates") == []


def test_where_to_stand_and_which_way_to_photograph(site: Site) -> None:
    site.enroll(0, place="gate", x=1, y=2, heading=10)
    site.enroll(1, place="gate", x=1, y=2, heading=80)
    site.enroll(2, place="yard", x=30, y=2)
    for seed, heading in enumerate((0, 90, 180, 270), 3):
        site.enroll(seed, x=60, y=0, heading=heading)

    [finding] = site.found("missing-directions")

    assert finding["remedy"] == "stand at 'gate' (x 1.0, y 2.0), photograph south (180°) and west (270°)"
    assert (finding["headings"], finding["position"]["x"], finding["places"]) == ([180, 270], 1, ["gate"])
    assert [one["places"] for one in site.found("single-view")] == [["yard"]]
    site.enroll(7, place="gate", x=1, y=2, heading=225)
    assert site.found("missing-directions") == []


@pytest.mark.parametrize(("east", "north"), [(("x", 1.0), ("y", 1.0)), (("lon", 1e-5), ("lat", 1e-5))])
def test_a_stretch_without_views_is_a_gap(site: Site, east: tuple[str, float], north: tuple[str, float]) -> None:
    ids = []
    for seed, metres in enumerate((0, 10, 20, 30, 100, 110, 120)):
        where: dict[str, Any] = {east[0]: metres * east[1], north[0]: 0}
        ids.append(site.enroll(seed, **where))

    [gap] = site.found("gap")

    assert gap["views"] == ids[3:5]
    assert ("70 m" if east[0] == "x" else "78 m") in gap["detail"]


def test_what_lies_far_from_the_first_view_is_measured_where_it_lies(site: Site) -> None:
    site.enroll(9, lat=90, lon=0)
    for seed, east in enumerate((0, 10, 20, 30, 100)):
        site.enroll(seed, lat=0, lon=36 + east * 1e-5)

    quarter, gap = site.found("gap")

    assert "there are 10007557 m without a view" in quarter["detail"]
    assert "there are 78 m without a view" in gap["detail"]
    assert len(site.found("single-view")) == 6


def test_the_list_is_as_long_as_wanted_and_says_what_it_leaves_out(site: Site) -> None:
    for seed in range(5):
        site.enroll(seed, place=f"place {seed}")
    health = site.health(limit=2)
    assert len(health["findings"]) == 2
    none = dict.fromkeys(("twins", "ageing", "never-matched", "duplicates", "missing-directions", "gap"), 0)
    assert health["counts"] == {**none, "single-view": 5}
    assert site.health(code="gap")["counts"] == {"gap": 0}
    assert site.health() == site.health()
    for wrong in ({"limit": 0}, {"limit": 501}, {"code": "boredom"}, {"colour": "red"}):
        assert site.client.get("/maps/site/health", params=wrong).status_code == 422
    assert site.client.get("/maps/moon/health").status_code == 404


def test_an_empty_map_lacks_nothing_yet(site: Site) -> None:
    site.client.put("/maps/site", json={})
    health = site.health()
    assert (health["views"], health["findings"]) == (0, [])
