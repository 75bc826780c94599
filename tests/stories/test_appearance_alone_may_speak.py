"""What words and appearance say together may be drowned in words; where appearance alone stands out, it counts."""

from pathlib import Path

import pytest

from app.http.application import create_app
from scenes import scene
from schemas.recipe import Channel, DenseCells, Parameters
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.stories.photos import photo
from worker.bootstrap import build

NAMES = ("mill lane", "station road", "the green", "harbour street", "school hill", "chapel row")


def test_asking_without_it_changes_likenesses_and_never_raises_them(tmp_path: Path) -> None:
    with CheckedClient(create_app(build(Settings(data=tmp_path, encoder="compact", threads=1)))) as client:
        joined = {"parameters": {"dense": {"alone": {"detail": 0}}}}
        assert client.put("/maps/joined", json=joined).status_code in (200, 201)
        jpeg = {"headers": {"content-type": "image/jpeg"}}
        for map_name in ("default", "joined"):
            for name in NAMES:
                client.post(f"/enroll?map={map_name}&place={name}", content=photo(scene(name).seen_from()), **jpeg)
        asked = photo(scene(NAMES[0]).seen_from(dx=0.6, turn=2))
        answers = {
            name: client.post(f"/query?map={name}&top=6", content=asked, **jpeg).json()["matches"]
            for name in ("default", "joined")
        }

    assert answers["default"][0]["view"]["place"] == answers["joined"][0]["view"]["place"] == NAMES[0]
    similarity = {
        name: {match["view"]["place"]: match["dense"]["similarity"] for match in matches}
        for name, matches in answers.items()
    }
    assert all(similarity["default"][name] >= similarity["joined"][name] for name in NAMES)
    assert any(similarity["default"][name] > similarity["joined"][name] + 0.001 for name in NAMES)


def test_a_recipe_from_before_keeps_its_identity_and_one_channel_is_nothing_beside_itself() -> None:
    assert "alone" not in DenseCells().model_dump()
    both = DenseCells(shares={"words": 0.4, "detail": 0.6}, alone={"detail": 6})
    assert both.model_dump()["alone"] == {"detail": 6}
    assert both.among({"words", "detail"}).alone == {"detail": 6}
    assert both.among({"detail"}).alone == {}


def test_a_channel_that_the_cells_do_not_have_cannot_be_read_alone() -> None:
    words = {"words": Channel(layer="words", words=8)}
    with pytest.raises(ValueError, match=r"dense\.alone: detail are not among the cells' words"):
        Parameters(channels=words, dense=DenseCells(alone={"detail": 6}))
