"""A place is matched ever less, week by week; the map's health says so, with the photo that would refresh it."""

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest

from app.http.application import create_app
from scenes import scene
from schemas.ageing import DayScore
from schemas.enrolment import EnrolmentOptions
from schemas.image import ImageFacts
from schemas.records import Position, ViewAttributes
from tests.openapi import CheckedClient
from tests.stories.importing import ended
from tests.stories.photos import photo
from tests.stories.running import settings
from tests.waiting import until
from worker.runtime import Runtime, build

JPEG = {"content-type": "image/jpeg"}
PLACES = ("mill lane", "station road", "rose garden", "old harbour", "market street", "castle park")
NOW = datetime.now(UTC)
FALLEN = [0.9, 0.86, 0.92, 0.88, 0.9, 0.91, 0.89, 0.6, 0.62, 0.58, 0.55, 0.61, 0.6]
STEADY = [0.8, 0.82, 0.79, 0.81, 0.83, 0.8, 0.78, 0.8, 0.79, 0.82, 0.8, 0.81, 0.78]
LOWER = [score - 0.2 * (i > 6) for i, score in enumerate(STEADY)]


class Town:
    """A map of six places by day, each with a position, enrolled a year ago; and its service."""

    def __init__(self, runtime: Runtime, client: CheckedClient, name: str) -> None:
        self.runtime, self.client, self.name = runtime, client, name
        self.path = f"/maps/{name}"

    def enrol(self) -> None:
        long_ago = NOW - timedelta(days=365)
        for number, name in enumerate(PLACES):
            for turn in (0, 6):
                self.take(name, Position(x=100.0 * number, y=1.0), turn, long_ago)
        self.settle()

    def take(self, name: str, where: Position, turn: float, then: datetime) -> None:
        """Enrol a photo of a place, as if it were another day."""
        body = photo(scene(name).seen_from(turn=turn))
        facts = ImageFacts(480, 360, len(body), "jpeg", hashlib.sha256(body).hexdigest())
        given, recipe = ViewAttributes(name, where), self.runtime.default_recipe
        self.runtime.store.enrolment.submit(self.name, body, facts, given, EnrolmentOptions(then, recipe))
        assert self.runtime.loop is not None
        self.runtime.loop.wake()

    def snapshot(self) -> bytes:
        """The map as a file."""
        job = self.client.post(f"{self.path}/snapshots").json()
        job = ended(self.client, job["id"])
        return bytes(self.client.get(f"/snapshots/{job['result']['snapshot']}").content)

    def settle(self) -> None:
        """Wait until all views are described."""
        until(lambda: not self.client.get(self.path).json()["views"]["pending"])

    def keep(self, count: int) -> None:
        assert self.client.patch(self.path, json={"keep_matches": count}).status_code == 200

    def view(self, name: str) -> Any:
        """The first view of a place."""
        return self.client.get("/views", params={"map": self.name, "place": name}).json()["views"][0]

    def matched(self, name: str, scores: Sequence[float]) -> None:
        """Let a place have been matched with these scores, every third day up to yesterday."""
        store, last = self.runtime.store, NOW.date() - timedelta(days=1)
        days = [DayScore(last - timedelta(days=3 * i), 2, 2 * score) for i, score in enumerate(reversed(scores))]
        seq = store.views.get(self.view(name)["id"]).seq
        store.day_scores.add(self.name, store.maps.get(self.name).recipe, {seq: days})

    def at_night(self, name: str, dx: float, **given: Any) -> Any:
        image = photo(scene(name).at("night").seen_from(dx=dx, turn=3))
        answer = self.client.post("/query", params={"map": self.name, **given}, content=image, headers=JPEG).json()
        assert (answer["status"], answer["places"][0]["place"]) == ("matched", name)
        return answer

    def health(self, **params: Any) -> Any:
        answer = self.client.get(f"{self.path}/health", params=params)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def ageing(self) -> Any:
        return self.health(code="ageing")["findings"]


@contextmanager
def service(data: Path) -> Iterator[tuple[Runtime, CheckedClient]]:
    runtime = build(settings(data, encoder="compact", compare=False, decoders=0))
    with CheckedClient(create_app(runtime)) as client:
        yield runtime, client


def restored(running: tuple[Runtime, CheckedClient], snapshot: bytes, name: str) -> Town:
    """A map of a snapshot, under a name of its own: nothing is described again."""
    town = Town(*running, name)
    answer = town.client.post(
        "/restore", params={"as": name}, content=snapshot, headers={"content-type": "application/x-tar"}
    )
    assert answer.status_code == 201, answer.text
    town.keep(50)
    return town


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory, database: str) -> Iterator[tuple[Runtime, CheckedClient]]:
    with service(tmp_path_factory.mktemp("town")) as made:
        yield made


@pytest.fixture(scope="module")
def snapshot(running: tuple[Runtime, CheckedClient]) -> bytes:
    town = Town(*running, "town")
    town.enrol()
    return town.snapshot()


@pytest.fixture
def town(running: tuple[Runtime, CheckedClient], snapshot: bytes) -> Iterator[Town]:
    town = restored(running, snapshot, f"town-{uuid4().hex}")
    yield town
    town.client.delete(town.path)


def test_a_place_whose_scores_fall_is_told_with_the_photo_that_refreshes_it(town: Town) -> None:
    for name in (name for name in PLACES if name != "station road"):
        town.matched(name, STEADY)
    town.matched("station road", FALLEN)
    assert town.ageing() == []  # six days of low scores are not enough
    first = town.at_night("station road", 0.9)["matches"][0]["score"]

    [found] = town.ageing()  # today is the seventh

    assert (found["places"], found["position"]["x"]) == (["station road"], 100)
    assert town.view("station road")["id"] in found["views"]
    scores = found["scores"]
    assert (scores["days"], scores["until"]) == (7, str(datetime.now(UTC).date()))
    assert scores["then"] == pytest.approx(0.9)
    assert scores["now"] == pytest.approx(0.6, abs=0.02)
    assert first < 0.7
    assert found["detail"].startswith("'station road' scores less than it did: 0.90 on the first 7 days")
    [proposal] = town.client.get(f"{town.path}/proposals").json()["proposals"]
    assert found["proposal"] == proposal["id"]
    assert "--unconfirmed" in found["remedy"]

    town.at_night("station road", 0.5)
    [found] = town.ageing()
    assert f"POST {town.path}/proposals/{proposal['id']}" in found["remedy"]
    assert "2 agree" in found["remedy"]
    assert town.health()["counts"]["ageing"] == 1

    taken = town.client.post(f"{town.path}/proposals/{proposal['id']}", json={"views": 1})
    assert taken.status_code == 200, taken.text
    town.settle()
    assert town.ageing() == []  # refreshed: what its newest days say is of before
    assert town.at_night("station road", 0.8)["matches"][0]["score"] > first + 0.1


def test_what_is_enrolled_now_stands_where_no_photo_was_kept(town: Town) -> None:
    town.matched("rose garden", [*FALLEN, 0.58])
    [found] = town.ageing()
    assert found["proposal"] is None
    assert found["remedy"] == "enrol a photo of it as it looks now, with the place 'rose garden'"
    image = photo(scene("rose garden").at("dusk").seen_from())
    given = {"map": town.name, "place": "rose garden", "x": 200.0, "y": 1.0}
    assert town.client.post("/enroll", params=given, content=image, headers=JPEG).status_code == 201
    assert town.ageing() == []


def test_a_photo_that_was_refused_refreshes_no_place(town: Town) -> None:
    town.matched("rose garden", [*FALLEN, 0.58])
    [before] = town.ageing()
    given = {"map": town.name, "place": "rose garden", "wait": "false", "refuse_poor": "true"}
    again = photo(scene("rose garden").seen_from(turn=0.01))  # nearly the same as by day, a year ago
    assert town.client.post("/enroll", params=given, content=again, headers=JPEG).status_code == 202
    town.settle()
    assert town.client.get(town.path).json()["views"]["failed"] == 1
    town.take("mill lane", Position(x=0.0, y=1.0), 12, NOW)  # the map is another one: trends are found anew
    town.settle()
    assert town.ageing() == [before]


def test_days_before_a_view_was_enrolled_are_not_compared_with_those_after_it(town: Town) -> None:
    enrolled = NOW - timedelta(days=3 * 13 + 2)
    for number, name in enumerate(PLACES[:2]):
        town.take(name, Position(x=100.0 * number, y=1.0), -6, enrolled)
    town.settle()
    fell_then, falls_since = [0.9] * 14 + [0.6] * 14, [0.95] * 14 + [0.85] * 7 + [0.6] * 7
    for name, scores in zip(PLACES, (fell_then, falls_since, [0.8] * 28, [0.8] * 28, [0.8] * 28), strict=False):
        town.matched(name, scores)

    [found] = town.ageing()

    assert found["places"] == [PLACES[1]]
    assert (found["scores"]["then"], found["scores"]["days"]) == (pytest.approx(0.85), 7)
    assert found["scores"]["since"] == str(NOW.date() - timedelta(days=3 * 13 + 1))


def test_places_that_fall_together_are_one_finding_of_the_map(town: Town) -> None:
    for name in PLACES:
        town.matched(name, [*LOWER, 0.6])
    [found] = town.ageing()
    assert (found["places"], found["count"], len(found["views"]), found["scores"]) == ([], 6, 6, None)
    assert found["detail"].startswith("6 of 6 places score less than they did, by 0.2")
    assert "camera" in found["remedy"]


def test_other_scores_begin_anew(town: Town) -> None:
    town.matched("old harbour", [*FALLEN, 0.58])
    assert len(town.ageing()) == 1
    assert town.client.patch(town.path, json={"ranking": {"candidates": 33}}).status_code == 200
    assert town.ageing() == []
    town.matched("old harbour", [0.6] * 14)
    assert town.ageing() == []


def test_nothing_is_noted_unless_the_map_keeps_matches_nor_of_a_part_of_it(town: Town) -> None:
    scores, write = town.runtime.store.day_scores, town.runtime.services.query.scores.write
    town.at_night("station road", 0.8, place="station road")
    write()
    assert scores.of(town.name) == []
    town.keep(0)
    town.at_night("station road", 0.8)
    write()
    assert scores.of(town.name) == []
    town.keep(50)
    answer = town.at_night("station road", 0.8)
    town.at_night("station road", 0.8)
    write()
    [view] = scores.of(town.name)
    [day] = view.days
    assert (view.known.name, day.count) == ("station road", 2)
    assert day.total == pytest.approx(2 * answer["matches"][0]["score"])
    gone = town.client.delete(f"/views/{view.id}").json()
    assert gone["scores"] == 1


def test_scores_that_wait_are_written_at_a_stop(snapshot: bytes, tmp_path: Path) -> None:
    with service(tmp_path) as running:
        town = restored(running, snapshot, "town")
        town.at_night("station road", 0.8)
        assert town.runtime.store.day_scores.of("town") == []  # once a minute, aside of the queries
    with service(tmp_path) as (again, _):
        assert len(again.store.day_scores.of("town")) == 1


def test_a_place_that_no_query_is_matched_with_is_told_until_one_is(town: Town) -> None:
    *busy, quiet = PLACES
    for name in busy:
        town.matched(name, STEADY[-9:])
    assert town.health(code="never-matched")["findings"] == []  # 24 days: perhaps nobody came there
    for name in busy:
        town.matched(name, STEADY)
    image = photo(scene("new gate").seen_from())
    assert town.client.post(f"/enroll?map={town.name}&place=new gate", content=image, headers=JPEG).status_code == 201

    [found] = town.health(code="never-matched")["findings"]  # and not the place that is new

    assert (found["places"], found["count"], found["position"]["x"]) == ([quiet], 2, 500)
    assert f"none of the {len(STEADY)} days" in found["detail"]
    assert town.health()["counts"]["never-matched"] == 1
    town.at_night(quiet, 0.5)
    assert town.health(code="never-matched")["findings"] == []
    town.keep(0)
    assert town.health()["counts"]["never-matched"] == 0
