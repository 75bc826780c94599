"""Confidence says how sure the first answer is, whatever else is wanted and however small the map."""

from collections.abc import Iterator

import pytest

from app.http.application import create_app
from scenes import scene
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.stories.photos import photo
from worker.runtime import build

pytestmark = pytest.mark.one_database("it is about how views are ranked, not where they lie")


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CheckedClient]:
    data = tmp_path_factory.mktemp("data")
    with CheckedClient(create_app(build(Settings(data=data, encoder="compact", threads=1, compare=False)))) as opened:
        yield opened


def test_it_does_not_depend_on_how_many_matches_are_wanted(client: CheckedClient) -> None:
    for name in ("mill lane", "station road", "rose garden"):
        client.post(
            f"/enroll?map=three&place={name}", content=photo(scene(name)), headers={"content-type": "image/jpeg"}
        )
    taken = photo(scene("foreign street"))
    answers = [
        client.post(f"/query?map=three&top={top}", content=taken, headers={"content-type": "image/jpeg"}).json()
        for top in (1, 2, 3)
    ]
    assert [len(answer["matches"]) for answer in answers] == [1, 2, 3]
    assert len({(answer["status"], answer["confidence"]) for answer in answers}) == 1


def test_the_only_view_of_a_map_is_not_everywhere(client: CheckedClient) -> None:
    home = scene("mill lane")
    client.post("/enroll?map=one&place=home", content=photo(home), headers={"content-type": "image/jpeg"})
    later, elsewhere = (
        client.post("/query?map=one", content=photo(look), headers={"content-type": "image/jpeg"}).json()
        for look in (home.seen_from(dx=0.4, turn=-3).behind("bus"), scene("foreign street"))
    )
    assert later["status"] == "matched"
    assert elsewhere["status"] == "no_match"
    assert elsewhere["confidence"] < 0.3
