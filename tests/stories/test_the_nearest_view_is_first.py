"""Along a street several views show the same houses; the one taken nearest shows them as large as the query does."""

from pathlib import Path

from app.http.application import create_app
from scenes import scene
from schemas.recipe import DenseCells
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.stories.photos import photo
from worker.bootstrap import build

STEPS = (0.0, 2.0, 4.0, 6.0)


def test_a_drive_down_a_street_knows_how_far_it_has_come(tmp_path: Path) -> None:
    street = scene("mill lane")
    with CheckedClient(create_app(build(Settings(data=tmp_path, encoder="compact", threads=1)))) as client:
        for ahead in STEPS:
            photographed = photo(street.seen_from(ahead=ahead))
            client.post(f"/enroll?place={ahead:g}", content=photographed, headers={"content-type": "image/jpeg"})
        for ahead in STEPS:
            asked = photo(street.seen_from(dx=0.5, ahead=ahead, turn=3).at("overcast"))
            answer = client.post("/query?top=4", content=asked, headers={"content-type": "image/jpeg"}).json()

            assert answer["matches"][0]["view"]["place"] == f"{ahead:g}"
            scales = {float(match["view"]["place"]): match["dense"]["scale"] for match in answer["matches"]}
            assert min(STEPS, key=lambda step: abs(scales[step] - 1)) == ahead
            assert all(scales[step] < 1 for step in STEPS if step < ahead)
            assert all(scales[step] > 1.05 for step in STEPS if step > ahead)


def test_a_recipe_from_before_the_scale_counted_keeps_its_identity() -> None:
    assert "scale_penalty" not in DenseCells().model_dump()
    assert DenseCells(scale_penalty=0.4).model_dump()["scale_penalty"] == 0.4
    assert DenseCells.model_validate(DenseCells().model_dump()) == DenseCells()
