"""A robot asks image after image: where single images leave it in doubt, the drive decides."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.http.application import create_app
from scenes import scene
from schemas.records import Filters, ViewAttributes
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.stories.photos import jpeg, photo
from worker.method.decision import decide
from worker.runtime import Runtime, build
from worker.service.drives import Driven, Drives
from worker.service.query_options import QueryOptions
from worker.service.results import RankedResults

pytestmark = pytest.mark.one_database("drives are kept in the memory of the service")

JPEG = {"content-type": "image/jpeg"}
NOT_KEPT = QueryOptions(keep=False)
STREET = [0.0, 3.0, 6.0, 9.0, 12.0, 15.0]


@pytest.fixture(scope="module")
def runtime(tmp_path_factory: pytest.TempPathFactory) -> Runtime:
    folder: Path = tmp_path_factory.mktemp("drive")
    return build(Settings(data=folder, encoder="compact", threads=1, compare=False))


@pytest.fixture(scope="module")
def client(runtime: Runtime) -> Iterator[CheckedClient]:
    with CheckedClient(create_app(runtime)) as running:
        street = scene("mill lane")
        for ahead in STREET:
            sent = photo(street.seen_from(ahead=ahead))
            assert running.post(f"/enroll?place={ahead:g}", content=sent, headers=JPEG).status_code == 201
        runtime.comparer.all()
        yield running


def put(client: CheckedClient, ahead: float, *, key: str | None = None, **parameters: Any) -> Any:
    taken = photo(scene("mill lane").seen_from(dx=0.6, ahead=ahead + 0.4, turn=4).at("dusk"))
    headers = JPEG if key is None else {**JPEG, "Idempotency-Key": key}
    answer = client.post("/query", params=parameters, content=taken, headers=headers)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_images_of_a_drive_are_counted_and_make_it_surer(client: CheckedClient) -> None:
    alone = [put(client, ahead) for ahead in STREET]
    together = [put(client, ahead, drive="robot-1") for ahead in STREET]

    assert all("drive" not in answer or answer["drive"] is None for answer in alone)
    assert [answer["drive"]["images"] for answer in together] == [1, 2, 3, 4, 5, 6]
    assert [answer["drive"]["single_frame_status"] for answer in together] == [answer["status"] for answer in alone]
    for single, driven in zip(alone, together, strict=True):
        sums = sum(place["probability"] for place in driven["drive"]["posterior"]) + driven["drive"]["nowhere"]
        assert sums == pytest.approx(1)
        assert sum(place["probability"] for place in driven["places"]) + driven["nowhere"] == pytest.approx(1)
        if single["status"] == "matched":
            assert driven["status"] == "matched"
    assert together[0]["matches"] == alone[0]["matches"]


def test_a_position_is_that_of_the_likeliest_views_not_the_mean_of_their_neighbours(
    client: CheckedClient, runtime: Runtime
) -> None:
    street = scene("mill lane")
    for ahead in STREET:  # 6 m from one to the next: further apart than a place is wide, and neighbours
        known = {"map": "surveyed", "place": f"{ahead:g}", "x": 2 * ahead, "y": 0}
        sent = photo(street.seen_from(ahead=ahead))
        assert client.post("/enroll", params=known, content=sent, headers=JPEG).status_code == 201
    runtime.comparer.all()
    answers = [put(client, ahead, drive="surveyor", map="surveyed", precision=0.5) for ahead in STREET]
    decided = [answer for answer in answers if answer["reason"]["detail"].startswith("the images of this drive")]
    assert len(decided) >= 3
    for answer in decided:
        first = answer["matches"][0]["view"]["position"]["x"]
        assert answer["estimate"]["position"]["x"] == pytest.approx(first, abs=3)


def test_what_the_drive_is_sure_of_comes_first_everywhere_in_the_answer(client: CheckedClient) -> None:
    answers = [put(client, ahead, drive="robot-2", precision=0.5) for ahead in STREET]
    decided = [answer for answer in answers if answer["reason"]["detail"].startswith("the images of this drive")]
    assert decided
    for answer in decided:
        likeliest = answer["drive"]["posterior"][0]
        assert answer["status"] == "matched"
        assert answer["matches"][0]["view"]["place"] == answer["places"][0]["place"] == likeliest["place"]
        assert answer["confidence"] == answer["places"][0]["probability"] == likeliest["probability"]
        assert [match["rank"] for match in answer["matches"]] == list(range(1, len(answer["matches"]) + 1))


def test_what_the_drive_only_leans_to_comes_first_too_and_is_ambiguous(client: CheckedClient) -> None:
    answers = [put(client, ahead, drive="robot-7", precision=0.999) for ahead in STREET]
    leaning = [answer for answer in answers if answer["reason"]["detail"].endswith("not sure of it yet")]
    assert leaning
    for answer in leaning:
        assert (answer["status"], answer["reason"]["code"]) == ("ambiguous", "weak")
        assert answer["drive"]["single_frame_status"] != "matched"
        likeliest = answer["drive"]["posterior"][0]
        assert answer["matches"][0]["view"]["place"] == answer["places"][0]["place"] == likeliest["place"]
        assert answer["confidence"] == likeliest["probability"] >= 0.5


def test_a_drive_is_forgotten_and_others_go_their_own_way(client: CheckedClient) -> None:
    put(client, 3.0, drive="robot-3")
    assert put(client, 6.0, drive="robot-3", drive_timeout=600)["drive"]["images"] == 2
    assert put(client, 6.0, drive="robot-4")["drive"]["images"] == 1
    time.sleep(0.11)
    assert put(client, 9.0, drive="robot-3", drive_timeout=0.1)["drive"]["images"] == 1
    assert put(client, 9.0, drive="robot-3", drive_timeout=600)["drive"]["images"] == 2


def test_an_image_sent_again_since_its_answer_was_lost_counts_once(client: CheckedClient) -> None:
    together = [put(client, ahead, drive="robot-8") for ahead in STREET[:4]]
    for ahead in STREET[:2]:
        put(client, ahead, drive="robot-9", key=f"image-{ahead}")
    lost, again = (put(client, STREET[2], drive="robot-9", key="third") for _ in range(2))
    following = put(client, STREET[3], drive="robot-9", key="fourth")

    assert lost["drive"] == again["drive"] == together[2]["drive"]
    assert following["drive"] == together[3]["drive"]
    assert put(client, STREET[3], drive="robot-9", key="fifth")["drive"]["images"] == 5  # it stands still
    assert put(client, STREET[3], drive="robot-9")["drive"]["images"] == 6
    assert put(client, STREET[3], drive="robot-9")["drive"]["images"] == 7


@pytest.mark.parametrize(
    "wrong",
    [
        {"drive": ""},
        {"drive": "a b"},
        {"drive": "a", "drive_timeout": 0},
        {"drive": "x" * 200},
        {"drive_timeout": 5},
        {"drive": "a", "consistent": 1},
        {"consistent": 3},
    ],
)
def test_wrong_names_and_times_are_refused(client: CheckedClient, wrong: dict[str, Any]) -> None:
    taken = photo(scene("mill lane").seen_from())
    refused = client.post("/query", params=wrong, content=taken, headers=JPEG)
    assert refused.status_code == 422
    assert refused.json()["errors"][0]["parameter"] in ("drive", "drive_timeout", "consistent")


def test_images_that_must_agree_are_matched_once_enough_in_a_row_do(client: CheckedClient) -> None:
    sure = [ahead for ahead in STREET if put(client, ahead, precision=0.5)["status"] == "matched"][:3]
    assert len(sure) == 3

    row = [put(client, ahead, drive="robot-6", consistent=3, precision=0.5) for ahead in sure]

    assert [answer["drive"]["single_frame_status"] for answer in row] == ["matched"] * 3
    assert [answer["drive"]["agreeing"] for answer in row] == [1, 2, 3]
    assert [answer["status"] for answer in row] == ["ambiguous", "ambiguous", "matched"]
    assert "only 2 of 3 images in a row of this drive agree" in row[1]["reason"]["detail"]
    assert [answer["matches"][0]["view"]["place"] for answer in row] == [f"{ahead:g}" for ahead in sure]
    # One that is not recognised begins the row anew; how many agree is told of drives that add up, too.
    elsewhere = photo(scene("foreign street").seen_from())
    wanted = {"drive": "robot-6", "consistent": 3}
    unknown = client.post("/query", params=wanted, content=elsewhere, headers=JPEG).json()
    assert (unknown["status"], unknown["drive"]["agreeing"]) == (unknown["drive"]["single_frame_status"], 0)
    assert put(client, sure[0], drive="robot-6", precision=0.5)["drive"]["agreeing"] == 1


def test_an_image_for_which_no_view_was_searched_ends_a_row(client: CheckedClient) -> None:
    """A robot that asks near where it believes to be, and is nowhere near the map for one image."""
    [sure, *_] = [ahead for ahead in STREET if put(client, ahead, precision=0.5)["status"] == "matched"]
    wanted: dict[str, Any] = {"drive": "robot-11", "consistent": 2, "precision": 0.5}
    first = put(client, sure, **wanted)
    nothing = put(client, sure, place="elsewhere", **wanted)
    then = [put(client, sure, **wanted) for _ in range(2)]
    assert [answer["drive"]["agreeing"] for answer in (first, nothing, *then)] == [1, 0, 1, 2]
    assert [answer["status"] for answer in (nothing, *then)] == ["no_match", "ambiguous", "matched"]
    assert [answer["drive"]["images"] for answer in (first, nothing, *then)] == [1, 1, 2, 3]


def test_an_empty_map_has_drives_too(client: CheckedClient) -> None:
    assert client.put("/maps/empty", json={}).status_code == 201
    answer = put(client, 0.0, map="empty", drive="robot-5")
    assert (answer["status"], answer["drive"]["images"], answer["drive"]["posterior"]) == ("no_match", 0, [])
    assert answer["drive"]["nowhere"] == 1


def test_a_map_that_was_made_anew_under_its_name_has_drives_of_its_own(client: CheckedClient) -> None:
    """Where the robot was before says nothing of where it is: the views are others."""
    images = []
    for town in ("mill lane", "castle park"):
        client.delete("/maps/rebuilt")
        for ahead in STREET[:2]:
            sent = photo(scene(town).seen_from(ahead=ahead))
            assert client.post(f"/enroll?map=rebuilt&place={ahead:g}", content=sent, headers=JPEG).status_code == 201
        images += [put(client, ahead, map="rebuilt", drive="robot-10")["drive"]["images"] for ahead in STREET[:2]]
    assert images == [1, 2, 1, 2]


@pytest.mark.parametrize("light", [0, 255])
@pytest.mark.parametrize("more", [{}, {"consistent": 3}])
def test_images_that_show_nothing_leave_a_drive_as_it_is(
    client: CheckedClient, light: int, more: dict[str, Any]
) -> None:
    """A hand before the lens, a black frame while the camera starts."""
    grain = np.random.default_rng(light).integers(0, 6, (240, 320, 3)) * (1 if light == 0 else -1)
    covered = jpeg((light + grain).astype(np.uint8))
    name = f"robot-{light}-{len(more)}"
    seen = [put(client, ahead, drive=f"{name}-seen", **more) for ahead in STREET]
    agreed = images = 0
    for ahead, without in zip(STREET, seen, strict=True):
        for _ in range(2):
            answer = client.post("/query", params={"drive": name, **more}, content=covered, headers=JPEG).json()
            assert (answer["status"], answer["reason"]["code"], answer["nowhere"]) == ("no_match", "poor-picture", 1)
            told = {
                "images": images,
                "posterior": [],
                "nowhere": 1,
                "single_frame_status": "no_match",
                "agreeing": agreed,
            }
            assert answer["drive"] == told
        again = put(client, ahead, drive=name, **more)
        assert (again["drive"], again["status"]) == (without["drive"], without["status"])
        agreed, images = again["drive"]["agreeing"], again["drive"]["images"]


def told(results: RankedResults, driven: Driven) -> list[tuple[float, str]]:
    """Probability and best view of each place."""
    return [(place.probability, results.views[place.views[0]].view.id) for place in driven.posterior]


def test_a_drive_finds_its_place_behind_the_views_that_an_image_has_already(
    client: CheckedClient, runtime: Runtime
) -> None:
    searcher = runtime.services.searcher
    looked_up: list[int] = []

    def further(results: RankedResults, count: int) -> RankedResults:
        looked_up.append(count)
        return searcher.further(results, count)

    def gone(results: RankedResults, count: int) -> RankedResults:
        return results

    few, many, deleted = Drives(further), Drives(further), Drives(gone)
    for ahead in [*STREET, *reversed(STREET)]:
        taken = photo(scene("mill lane").seen_from(dx=0.6, ahead=ahead + 0.4, turn=14).at("dusk"))
        image = runtime.services.query.query(taken, "default", options=NOT_KEPT)
        answers = []
        for drives, top in ((few, 1), (many, len(STREET)), (deleted, 1)):
            recipe = image.results.recipe.description
            results = searcher.search({"default": Filters()}, recipe, image.description, top=top)
            alone = decide(results.ranking, results.levels, results.calibration, 0.5, searched=results.searched)
            results, decision, driven = drives.follow(("default", "robot"), 60, results, alone)
            answers.append((decision.status, decision.confidence, results.views[0].view.id, told(results, driven)))
        assert answers[0] == answers[1]
        assert len(answers[2][-1]) == 1
    assert max(looked_up, default=0) > 1


def test_images_under_way_together_count_whichever_is_answered_first(client: CheckedClient, runtime: Runtime) -> None:
    """The map grew between them, and the one that was searched after that is answered before the other."""
    drives = Drives(runtime.services.searcher.further)
    searched = []
    for ahead in STREET[:2]:
        taken = photo(scene("mill lane").seen_from(dx=0.6, ahead=ahead, turn=14))
        runtime.services.enroll.enroll(taken, "grows", ViewAttributes(place=f"{ahead:g}"), patience_s=60)
        searched.append(runtime.services.query.query(taken, "grows", options=NOT_KEPT))
    first, second = (one.results for one in searched)
    assert first.first_map.revision < second.first_map.revision

    counted = []
    for results in (second, first):
        alone = decide(results.ranking, results.levels, results.calibration, 0.5, searched=results.searched)
        counted.append(drives.follow(("grows", "robot"), 60, results, alone)[2].images)
    assert counted == [1, 2]
