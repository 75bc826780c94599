"""What meaning and appearance say together may be drowned in meaning; where appearance alone stands out, it counts."""

from pathlib import Path

import pytest

from app.http.application import create_app
from scenes import scene
from schemas.description import DETAIL, SEMANTIC
from schemas.errors import InvalidParameters
from schemas.recipe import CellGrid, Channel, DescriptionParameters, DescriptionRecipe, MapRecipe, RankingConfig
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.stories.photos import photo
from worker.description.presets import changed_ranking
from worker.runtime import build

pytestmark = pytest.mark.one_database("it is about how views are ranked, not where they lie")

NAMES = ("mill lane", "station road", "the green", "harbour street", "school hill", "chapel row")


def test_querying_without_it_changes_similarities_and_never_raises_them(tmp_path: Path) -> None:
    with CheckedClient(create_app(build(Settings(data=tmp_path, encoder="compact", threads=1)))) as client:
        joined = {"ranking": {"detail_only_top_k": 0}}
        assert client.put("/maps/joined", json=joined).status_code in (200, 201)
        jpeg = {"headers": {"content-type": "image/jpeg"}}
        for map_name in ("default", "joined"):
            for name in NAMES:
                client.post(f"/enroll?map={map_name}&place={name}", content=photo(scene(name).seen_from()), **jpeg)
        taken = photo(scene(NAMES[0]).seen_from(dx=0.6, turn=2))
        answers = {
            name: client.post(f"/query?map={name}&top=6", content=taken, **jpeg).json()
            for name in ("default", "joined")
        }

    assert answers["default"]["recipe"] == answers["joined"]["recipe"]
    assert answers["default"]["ranking"] != answers["joined"]["ranking"]
    matches = {name: answer["matches"] for name, answer in answers.items()}
    assert matches["default"][0]["view"]["place"] == matches["joined"][0]["view"]["place"] == NAMES[0]
    similarity = {
        name: {match["view"]["place"]: match["dense"]["similarity"] for match in found}
        for name, found in matches.items()
    }
    assert all(similarity["default"][name] >= similarity["joined"][name] for name in NAMES)
    assert any(similarity["default"][name] > similarity["joined"][name] + 0.001 for name in NAMES)


def channels(*names: str) -> dict[str, Channel]:
    return {name: Channel(layer=name, vocabulary_size=8) for name in names}


def recipe(parameters: DescriptionParameters) -> DescriptionRecipe:
    return DescriptionRecipe(
        encoder="e", weights="w", labels=("sky", "road"), dynamic=(), parameters=parameters, vocabulary="v"
    )


def test_a_ranking_that_does_not_ask_for_it_has_it_off_and_one_channel_is_nothing_beside_itself() -> None:
    both = channels(SEMANTIC, DETAIL)
    wanted = RankingConfig(detail_only_top_k=6)
    shared = CellGrid(channel_weights={SEMANTIC: 0.4, DETAIL: 0.6})

    assert RankingConfig.model_validate({}).detail_only(recipe(DescriptionParameters(channels=both, dense=shared))) == 0
    for dense, expected in (
        (shared, 6),
        (CellGrid(), 6),
        (CellGrid(channel_weights={DETAIL: 0.6}), 0),
        (CellGrid(channel_weights={SEMANTIC: 0.6}), 0),
        (None, 0),
    ):
        assert wanted.detail_only(recipe(DescriptionParameters(channels=both, dense=dense))) == expected
    for name in (SEMANTIC, DETAIL):
        alone = DescriptionParameters(channels=channels(name), dense=CellGrid())
        assert wanted.detail_only(recipe(alone)) == 0


def test_a_channel_that_the_cells_do_not_have_cannot_be_read_alone() -> None:
    parameters = DescriptionParameters(channels=channels(SEMANTIC), dense=CellGrid())
    present = MapRecipe(description=recipe(parameters), ranking=RankingConfig())

    with pytest.raises(InvalidParameters) as refusal:
        changed_ranking(present, {"detail_only_top_k": 6})

    [error] = refusal.value.errors
    assert error.parameter == "ranking.detail_only_top_k"
    assert error.detail == "needs dense cells that join 'detail' with another channel; these join semantic"
