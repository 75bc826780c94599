"""Along a street several views show the same houses; the one taken nearest shows them as large as the query does."""

from pathlib import Path

import pytest

from app.http.application import create_app
from scenes import scene
from schemas.recipe import RankingConfig
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.stories.photos import photo
from worker.runtime import build

pytestmark = pytest.mark.one_database("it is about how views are ranked, not where they lie")

STEPS = (0.0, 2.0, 4.0, 6.0)


def test_a_drive_down_a_street_knows_how_far_it_has_come(tmp_path: Path) -> None:
    street = scene("mill lane")
    with CheckedClient(create_app(build(Settings(data=tmp_path, encoder="compact", threads=1)))) as client:
        for ahead in STEPS:
            photographed = photo(street.seen_from(ahead=ahead))
            client.post(f"/enroll?place={ahead:g}", content=photographed, headers={"content-type": "image/jpeg"})
        for ahead in STEPS:
            taken = photo(street.seen_from(dx=0.5, ahead=ahead, turn=3).at("overcast"))
            answer = client.post("/query?top=4", content=taken, headers={"content-type": "image/jpeg"}).json()

            assert answer["matches"][0]["view"]["place"] == f"{ahead:g}"
            scales = {float(match["view"]["place"]): match["dense"]["scale"] for match in answer["matches"]}
            assert min(STEPS, key=lambda step: abs(scales[step] - 1)) == ahead
            assert all(scales[step] < 1 for step in STEPS if step < ahead)
            assert all(scales[step] > 1.05 for step in STEPS if step > ahead)


def test_how_much_scale_counts_changes_at_once_and_no_description_changes_its_identity(tmp_path: Path) -> None:
    street, sent = scene("mill lane"), {"headers": {"content-type": "image/jpeg"}}
    with CheckedClient(create_app(build(Settings(data=tmp_path, encoder="compact", threads=1)))) as client:
        for ahead in (0.0, 6.0):
            client.post(f"/enroll?place={ahead:g}", content=photo(street.seen_from(ahead=ahead)), **sent)
        taken = photo(street.seen_from(dx=0.5, turn=3))
        before, facts = client.post("/query", content=taken, **sent).json(), client.get("/maps/default").json()
        changed = client.patch("/maps/default", json={"ranking": {"scale_penalty": 0}}).json()
        after = client.post("/query", content=taken, **sent).json()
        jobs = client.get("/jobs").json()["jobs"]

    assert (facts["ranking"]["scale_penalty"], changed["ranking"]["scale_penalty"]) == (0.4, 0)
    assert (changed["recipe"], changed["views"]) == (facts["recipe"], facts["views"])
    assert {job["kind"] for job in jobs} == {"describe"}
    assert after["recipe"] == before["recipe"]
    assert (before["ranking"], after["ranking"]) == (facts["ranking"]["id"], changed["ranking"]["id"])
    assert before["ranking"] != after["ranking"]
    [far_before, far_after] = (
        next(match for match in answer["matches"] if match["view"]["place"] == "6") for answer in (before, after)
    )
    assert far_before["dense"]["scale"] == far_after["dense"]["scale"] > 1.05
    assert far_after["parts"]["dense_full"] > far_before["parts"]["dense_full"]


def test_a_ranking_that_does_not_say_how_much_scale_counts_does_not_count_it() -> None:
    assert RankingConfig.model_validate({}).scale_penalty == 0
    assert RankingConfig.model_validate(RankingConfig(scale_penalty=0.4).model_dump()).scale_penalty == 0.4
