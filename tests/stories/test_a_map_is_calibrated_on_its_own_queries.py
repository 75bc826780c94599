"""A user labels queries of their own site: the map's confidences follow them, or it is said that they cannot."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from app.http.application import create_app
from tests.openapi import CheckedClient
from tests.sample_images import drawn, encoded
from tests.stories.running import settings
from worker.runtime import build

JPEG = {"content-type": "image/jpeg"}
PLACES, LONE = 8, 8


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory, database: str) -> Iterator[CheckedClient]:
    data = tmp_path_factory.mktemp("data")
    runtime = build(settings(data, compare=False))
    with CheckedClient(create_app(runtime)) as opened:
        yield opened


@pytest.fixture(scope="module")
def enrolled(client: CheckedClient) -> list[dict[str, Any]]:
    """Views of a map: eight places seen three times, and eight seen once."""
    views = []
    for place in range(PLACES + LONE):
        for again in range(3 if place < PLACES else 1):
            image = encoded(drawn(96, 72, place), "jpeg", quality=95 - 20 * again)
            where = f"map=site&place=place {place}&x={100 * place + again}&y=0"
            views.append(client.post(f"/enroll?{where}", content=image, headers=JPEG).json()["view"])
    return views


@pytest.fixture
def site(client: CheckedClient, enrolled: list[dict[str, Any]]) -> Iterator[list[dict[str, Any]]]:
    """The views, of a map that decides as it did at first."""
    ranking = client.get("/maps/site").json()["ranking"]
    yield enrolled
    client.patch("/maps/site", json={"ranking": {name: ranking[name] for name in ("precision", "candidates")}})
    client.delete("/maps/site/calibration")


def observed(n: int, right: float, gap: float, seed: int = 0, **label: Any) -> list[dict[str, Any]]:
    rng = np.random.default_rng(seed)
    found = [(float(g), float(level)) for g, level in zip(rng.normal(gap, 0.4, n), -rng.random(n) / 2, strict=True)]
    rest = {"own": 0.3, "either": 1.1}
    return [
        {
            "features": {"gap": max(g, 0.0), "level": level, "breadth": max(g, 0.0) / 2, **rest},
            "right": bool(hit),
            **label,
        }
        for (g, level), hit in zip(found, rng.random(n) < right, strict=True)
    ]


HARD = observed(150, 0.55, 1.6) + observed(150, 0.05, 0.6, seed=1)
"""Look-alikes: what stands out elsewhere is wrong here nearly as often as right."""


def calibrate(client: CheckedClient, **body: Any) -> Any:
    return client.post("/maps/site/calibration", json=body)


def query(client: CheckedClient, place: int = 0) -> Any:
    answer = client.post(
        "/query?map=site", content=encoded(drawn(96, 72, place), "jpeg", quality=90), headers=JPEG
    ).json()
    del answer["timing_ms"], answer["query"]["id"]
    return answer


def refused(answer: Any) -> dict[str, str]:
    assert answer.status_code == 422, answer.text
    return {error["parameter"]: error["detail"] for error in answer.json()["errors"]}


def test_answers_that_were_observed_change_confidences_until_they_are_forgotten(
    client: CheckedClient, site: list[dict[str, Any]]
) -> None:
    before = query(client)
    report = calibrate(client, observed=HARD, dry_run=True).json()
    assert (report["kept"], report["transfers"], report["queries"]) == (False, True, 300)
    assert query(client) == before

    report = calibrate(client, observed=HARD, recipe=before["recipe"], ranking=before["ranking"]).json()

    assert report["kept"]
    assert report["revision"] > before["revision"]
    assert report["own"]["log_loss"] < report["shipped"]["log_loss"]
    assert report["own"]["expected_error"] < report["shipped"]["expected_error"]
    after = query(client)
    assert after == query(client)  # the same at one revision
    assert after["revision"] == report["revision"]
    assert after["matches"][0]["score"] == before["matches"][0]["score"]
    assert after["confidence"] != before["confidence"]
    wanted = next(one for one in report["thresholds"] if one["precision"] == report["precision"])
    assert after["decision"]["threshold"] == pytest.approx(wanted["threshold"])

    facts = client.get("/maps/site").json()["decision"]
    assert facts["source"] == "calibration"
    assert facts["expected"]["queries"] == 300
    assert facts["expected"]["matched_share"] == pytest.approx(wanted["matched_share"])
    assert facts["expected"]["precision"] == report["own"]["precision"]["value"]
    assert facts["updated_at"] is not None

    facts = client.delete("/maps/site/calibration").json()["decision"]
    assert (facts["source"], facts["expected"]["queries"]) == ("cohort", None)
    assert query(client)["confidence"] == before["confidence"]
    assert client.delete("/maps/moon/calibration").status_code == 404


def test_a_change_of_what_scores_drops_it_and_one_of_the_precision_does_not(
    client: CheckedClient, site: list[dict[str, Any]]
) -> None:
    calibrate(client, observed=HARD)
    for ranking, source in (({"precision": 0.9}, "calibration"), ({"candidates": 7}, "cohort")):
        facts = client.patch("/maps/site", json={"ranking": ranking}).json()
        assert facts["decision"]["source"] == source


def test_views_are_queries_that_do_not_find_themselves(client: CheckedClient, site: list[dict[str, Any]]) -> None:
    names = [{"view": view["id"], "place": view["place"] if i < 3 * PLACES else None} for i, view in enumerate(site)]
    spots = [
        {"view": view["id"], "position": {"x": view["position"]["x"], "y": view["position"]["y"]}} for view in site
    ]
    for queries in (names, spots):
        report = calibrate(client, queries=queries, dry_run=True).json()
        assert (report["queries"], report["right"]) == (3 * PLACES + LONE, 3 * PLACES)
        assert report["unknown"] == LONE  # nothing but the query itself lies there
    wrong = [{**label, "place": "place 0"} if label["place"] else label for label in names]
    assert calibrate(client, queries=wrong, dry_run=True).json()["right"] == 3
    far = [{"view": view["id"], "position": {"x": view["position"]["x"] + 40, "y": 0.0}} for view in site]
    assert calibrate(client, queries=far, within=60, dry_run=True).json()["right"] == 3 * PLACES
    assert "all answers are wrong" in refused(calibrate(client, queries=far))["queries"]


def test_labels_that_teach_nothing_leave_the_map_as_it_is(client: CheckedClient, site: list[dict[str, Any]]) -> None:
    """Monday contradicts the shipped curve, and Tuesday Monday."""
    monday = observed(60, 0.2, 1.8, block="monday") + observed(60, 0.0, 0.3, 1, block="monday")
    tuesday = observed(200, 1.0, 1.8, 2, block="tuesday") + observed(200, 0.0, 0.3, 3, block="tuesday")
    before = query(client)

    report = calibrate(client, observed=monday + tuesday).json()

    assert (report["transfers"], report["kept"], report["blocks"]) == (False, False, 2)
    assert "does not transfer" in report["detail"]
    assert query(client) == before


def test_too_few_labels_are_refused_with_what_is_missing(client: CheckedClient, site: list[dict[str, Any]]) -> None:
    assert "at least 20" in refused(calibrate(client))["observed"]
    unanswered = [{"features": {}, "right": False}] * 30
    assert "0 labelled queries" in refused(calibrate(client, observed=unanswered))["observed"]
    assert calibrate(client, observed=HARD + unanswered, dry_run=True).json()["unanswered"] == 30
    alike = [{**one, "right": True} for one in HARD]
    assert "all answers are right" in refused(calibrate(client, observed=alike))["observed"]


def test_every_mistake_in_the_labels_is_named(client: CheckedClient, site: list[dict[str, Any]]) -> None:
    elsewhere = client.post("/enroll?map=other", content=encoded(drawn(96, 72, 99), "jpeg"), headers=JPEG).json()
    errors = refused(
        calibrate(
            client,
            observed=[{"features": {"gap": 1.0}, "right": True}],
            queries=[
                {"view": "moon", "place": "place 0"},
                {"view": elsewhere["view"]["id"], "place": None},
                {"view": site[0]["id"], "place": "plaice 0"},
                {"view": site[0]["id"], "position": {"lat": 1.0, "lon": 2.0}},
            ],
        )
    )
    named = {f"queries.{wrong}" for wrong in ("0.view", "1.view", "2.place", "3.position")}
    assert errors.keys() == {"observed.0.features", *named}
    assert "lacks level and breadth" in errors["observed.0.features"]
    assert "'plaice 0'" in errors["queries.2.place"]
    assert errors["queries.3.position"] == "is in degrees, in which no view of the map has a position"


def test_answers_by_another_ranking_are_not_mixed_in(client: CheckedClient, site: list[dict[str, Any]]) -> None:
    answer = query(client)
    client.patch("/maps/site", json={"ranking": {"candidates": 7}})
    refusal = calibrate(client, observed=HARD, recipe=answer["recipe"], ranking=answer["ranking"])
    assert refusal.status_code == 409
    assert answer["ranking"] in refusal.json()["detail"]
