"""The whole life of a map over HTTP, and the same life with the power going between any two of its steps.

A recording is imported, asked in every way, driven along, corrected, taught its own words, described anew while it is
asked, taken back, and carried to another machine with the other database, where it gives the same answers.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from tests.sample_images import encoded
from tests.storage.databases import postgres_schema
from tests.stories.importing import ZIP, ended, zipped
from tests.stories.running import RunningService
from tests.waiting import until

pytestmark = pytest.mark.one_database("it has databases of its own")

JPEG = {"content-type": "image/jpeg"}
TAR = {"content-type": "application/x-tar"}
STOPS = 16
GARDEN = 120
"""Further places: a vocabulary of the map's own is learned from more than 128."""

VIEWS = STOPS + GARDEN
LABELS = ["road", "sky", "building"]


def photo(name: str, quality: int = 92, tile: int = 20) -> bytes:
    """A wall of coloured tiles, other ones for another name."""
    tiles = np.random.default_rng(list(name.encode())).integers(0, 256, (12, 16, 3), np.uint8)
    return encoded(tiles.repeat(tile, axis=0).repeat(tile, axis=1), "jpeg", quality=quality)


def stop(number: int) -> str:
    """The place of a stop on the walk."""
    return f"floor{1 + number % 2}/door {number}"


def recording() -> bytes:
    """The walk as a table editor would save it: semicolons, decimal commas, names of its own."""
    rows = ["filename;place_name;easting;northing;timestamp;floor"]
    rows += [f"{n:02}.jpg;{stop(n)};{10 * n},5;0,25;2026-03-01T09:{n:02}:00Z;{1 + n % 2}" for n in range(STOPS)]
    rows += [f"aside/{n:03}.jpg;bed {n};;;;" for n in range(GARDEN)]
    images: dict[str, bytes | str] = {f"aside/{n:03}.jpg": photo(f"bed {n}", tile=4) for n in range(GARDEN)}
    images |= {f"walk/{n:02}.jpg": photo(stop(n)) for n in range(STOPS)}
    return zipped({**images, "manifest.csv": "\n".join(rows)})


class Life:
    """A service that can be killed at any time, and what its user remembers."""

    def __init__(self, data: Path, **environment: str) -> None:
        self._data, self._environment = data, environment
        self.job = ""
        self.answers: dict[str, Any] = {}
        self.recipe = ""
        self.file = b""
        self._start()

    def _start(self) -> None:
        self.service = RunningService(self._data, **self._environment)
        self.client = httpx.Client(base_url=self.service.url, timeout=60)

    def kill(self) -> None:
        """The power goes, and comes back."""
        self.client.close()
        self.service.kill()
        self._start()

    def close(self) -> None:
        self.client.close()
        self.service.stop()

    def begins(self, path: str, **body: Any) -> None:
        """Begin a job, to be waited for by the next step."""
        answer = self.client.post(path, **body)
        assert answer.status_code == 202, answer.text
        self.job = answer.json()["id"]

    def done(self) -> dict[str, Any]:
        """The job that the step before began, once it is done."""
        job = ended(self.client, self.job)
        assert job["state"] == "done", job
        return job

    def query(self, name: str, quality: int = 85, **params: Any) -> dict[str, Any]:
        """The answer to a photo of a place."""
        given = {"map": "town", **params}
        answer = self.client.post("/query", params=given, content=photo(name, quality), headers=JPEG)
        assert answer.status_code == 200, answer.text
        told: dict[str, Any] = answer.json()
        return told

    def settled(self) -> dict[str, Any]:
        """The map, once every view is described."""
        until(lambda: self.client.get("/maps/town").json()["views"]["pending"] == 0)
        facts: dict[str, Any] = self.client.get("/maps/town").json()
        return facts

    def answers_now(self) -> dict[str, Any]:
        """Answers to a photo of each place, and of one that nobody has seen, without what differs from call to call."""
        self.settled()
        found = {}
        for name in (*map(stop, range(STOPS)), "dock", "moon"):
            told = self.query(name)
            for ephemeral in ("timing_ms", "query", "revision"):
                del told[ephemeral]
            found[name] = told
        return found


def first(told: dict[str, Any]) -> str | None:
    """The place that an answer is sure of."""
    if told["status"] != "matched":
        return None
    place: str = told["matches"][0]["view"]["place"]
    return place


def import_the_recording(life: Life) -> None:
    life.begins("/maps/town/imports", content=recording(), headers=ZIP)


def it_is_imported_and_again_it_is_there_already(life: Life) -> None:
    report = life.done()["result"]
    assert (report["enrolled"], report["failed"], report["errors"]) == (VIEWS, 0, [])
    life.begins("/maps/town/imports", content=recording(), headers=ZIP)
    assert life.done()["result"]["already_there"] == VIEWS
    assert life.settled()["views"] == {"pending": 0, "ready": VIEWS, "failed": 0}


def ask_with_each_filter(life: Life) -> None:
    views = life.client.get("/views", params={"map": "town", "limit": 500}).json()["views"]
    upstairs = {"$or": [{"place": {"$prefix": "floor2/"}}, {"metadata.floor": "2"}]}
    last = views[-1]["id"]
    searched = {
        "near": ("30.5,0.25,11", 3),
        "after": ("2026-03-01T09:10:00Z", STOPS - 10),
        "before": ("2026-03-01T09:03:00Z", 4),
        "place": (stop(3), 1),
        "metadata.floor": ("2", STOPS // 2),
        "exclude_last": ("4", VIEWS - 4),
        "exclude": (f"{views[0]['id']},{last}", VIEWS - 2),
        "where": (json.dumps({"$and": [upstairs, {"x": {"$lt": 45}}, {"$not": {"place": stop(1)}}]}), 1),
    }
    for name, (value, count) in searched.items():
        told = life.query(stop(3), 85, **{name: value})
        assert told["searched"] == count, name
        listed = life.client.get("/views", params={"map": "town", "limit": 500, name: value}).json()["views"]
        assert len(listed) == count, name
        if name != "after":
            assert first(told) == stop(3), name
    assert life.query(stop(3), place="nowhere")["reason"]["code"] == "empty"
    both = life.client.post("/query", params={"maps": "town,town2"}, content=photo(stop(3)), headers=JPEG)
    assert both.status_code == 404


def drive_along(life: Life) -> None:
    driven = [life.query(stop(n), drive="robot") for n in range(6)]
    assert [told["drive"]["images"] for told in driven] == list(range(1, 7))
    assert [told["matches"][0]["view"]["place"] for told in driven] == [stop(n) for n in range(6)]
    for told in driven:
        assert sum(one["probability"] for one in told["drive"]["posterior"]) + told["drive"][
            "nowhere"
        ] == pytest.approx(1)


def meet_an_unknown_place(life: Life) -> None:
    assert life.client.patch("/maps/town", json={"keep_queries": 50, "keep_matches": 50}).status_code == 200
    for quality in (92, 80, 70):
        assert life.query("dock", quality)["status"] == "no_match"


def name_it_once(life: Life) -> None:
    [spot] = life.client.get("/maps/town/unknown").json()["places"]
    assert spot["count"] == 3
    named = life.client.post(f"/maps/town/unknown/{spot['id']}", json={"place": "dock", "position": {"x": 0, "y": 40}})
    assert (named.status_code, named.json()["queries"]) == (200, 3)


def it_is_known_from_then_on(life: Life) -> None:
    assert life.settled()["views"]["ready"] == VIEWS + 3
    assert first(life.query("dock")) == "dock"
    assert life.client.get("/maps/town/unknown").json()["places"] == []


def delete_what_is_wrong(life: Life) -> None:
    [view] = life.client.get("/views", params={"map": "town", "place": stop(15)}).json()["views"]
    receipt = life.client.delete(f"/views/{view['id']}").json()
    assert (receipt["views"], receipt["images"], receipt["searched"]) == (1, 1, 1)
    given = {"map": "town", "where": json.dumps({"x": {"$gt": 135}})}
    assert life.client.delete("/views", params=given).json()["views"] == 1
    assert life.client.get(view["links"]["image"]).status_code == 404


def it_stays_deleted_and_its_health_is_told(life: Life) -> None:
    assert life.settled()["views"]["ready"] == VIEWS + 1
    for gone in (14, 15):
        assert first(life.query(stop(gone))) is None
    health = life.client.get("/maps/town/health").json()
    assert (health["views"], health["examined"]) == (VIEWS + 1, VIEWS + 1)
    assert health["counts"]["single-view"] == VIEWS - 2
    assert health["counts"]["duplicates"] >= 1  # the three photos of the dock


def train_a_vocabulary(life: Life) -> None:
    life.recipe = life.client.get("/maps/town").json()["recipe"]["id"]
    life.begins("/maps/town/vocabulary")


def it_is_described_by_its_own_words(life: Life) -> None:
    life.done()
    facts = life.settled()
    assert facts["recipe"]["id"] != life.recipe
    life.recipe = facts["recipe"]["id"]
    life.answers = life.answers_now()
    assert {told["recipe"] for told in life.answers.values()} == {life.recipe}
    assert [first(life.answers[stop(n)]) for n in range(STOPS - 2)] == [stop(n) for n in range(STOPS - 2)]


def switch_while_asking(life: Life) -> None:
    life.begins("/maps/town/recipe", json={"labels": LABELS, "dynamic": []})
    for number in range(6):  # whether it has changed over or not
        told = life.query(stop(number))
        assert told["matches"][0]["view"]["place"] == stop(number)
        if told["recipe"] == life.recipe:
            assert told["searched"] == VIEWS + 1


def it_has_changed_over(life: Life) -> None:
    life.done()
    facts = life.settled()
    assert facts["recipe"]["id"] != life.recipe
    assert [label["label"] for label in facts["labels"]] == LABELS
    assert life.query(stop(2))["recipe"] == facts["recipe"]["id"]


def roll_back(life: Life) -> None:
    before = life.client.get("/maps/town").json()["recipe"]["id"]
    known = life.client.put("/maps/blank", json={}).json()["labels"]
    fields = {
        "labels": [label["label"] for label in known],
        "dynamic": [label["label"] for label in known if label["dynamic"]],
    }
    life.begins("/maps/town/recipe", json=fields)
    assert before != life.recipe


def it_answers_as_before_the_switch(life: Life) -> None:
    life.done()
    assert life.client.get("/maps/town").json()["recipe"]["id"] == life.recipe
    assert life.answers_now() == life.answers


def take_a_snapshot(life: Life) -> None:
    life.begins("/maps/town/snapshots")


def it_is_fetched(life: Life) -> None:
    made = life.done()["result"]
    assert made["views"] == VIEWS + 1
    life.file = life.client.get(f"/snapshots/{made['snapshot']}").content
    assert len(life.file) == made["bytes"]


STEPS: tuple[Callable[[Life], None], ...] = (
    import_the_recording,
    it_is_imported_and_again_it_is_there_already,
    ask_with_each_filter,
    drive_along,
    meet_an_unknown_place,
    name_it_once,
    it_is_known_from_then_on,
    delete_what_is_wrong,
    it_stays_deleted_and_its_health_is_told,
    train_a_vocabulary,
    it_is_described_by_its_own_words,
    switch_while_asking,
    it_has_changed_over,
    roll_back,
    it_answers_as_before_the_switch,
    take_a_snapshot,
    it_is_fetched,
)


def flipped(file: bytes, at: int) -> bytes:
    """A file with one changed byte."""
    return file[:at] + bytes([file[at] ^ 1]) + file[at + 1 :]


@pytest.mark.parametrize(
    "killed",
    [
        pytest.param(False, id="undisturbed"),
        pytest.param(True, id="killed between any two steps", marks=pytest.mark.slow),
    ],
)
@pytest.mark.timeout(1800)  # it starts the service dozens of times, and a slow machine needs ten minutes
def test_a_map_lives_and_is_carried_to_the_other_database(tmp_path: Path, killed: bool) -> None:
    life = Life(tmp_path / "home")
    try:
        for step in STEPS:
            step(life)
            if killed:
                life.kill()
    finally:
        life.close()
    with postgres_schema() as url:
        away = Life(tmp_path / "away", REVISIT_DATABASE=url)
        try:
            refused = away.client.post("/restore", content=flipped(life.file, len(life.file) // 3), headers=TAR)
            assert (refused.status_code, away.client.get("/maps").json()["maps"]) == (400, [])
            restored = away.client.post("/restore", content=life.file, headers=TAR)
            assert (restored.status_code, restored.json()["views"]) == (201, VIEWS + 1)
            if killed:
                away.kill()
            assert away.client.post("/restore", content=life.file, headers=TAR).status_code == 409
            assert away.answers_now() == life.answers
        finally:
            away.close()
    assert not (tmp_path / "away" / "revisit.db").exists()
