"""Confidence says how sure the first answer is, whatever else is wanted and however small the map."""

from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from app.http.application import create_app
from scenes import scene
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.stories.photos import jpeg, photo
from tests.stories.running import settings
from worker.runtime import Runtime, build

pytestmark = pytest.mark.one_database("it is about how views are ranked, not where they lie")


@pytest.fixture(scope="module")
def runtime(tmp_path_factory: pytest.TempPathFactory) -> Runtime:
    return build(Settings(data=tmp_path_factory.mktemp("data"), encoder="compact", threads=1, compare=False))


@pytest.fixture(scope="module")
def client(runtime: Runtime) -> Iterator[CheckedClient]:
    with CheckedClient(create_app(runtime)) as opened:
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


def test_the_order_does_not_depend_on_it_either(tmp_path: Path) -> None:
    """Where few are re-ranked, or none: a view that is eleventh by both channels may be among the first ten."""
    with CheckedClient(create_app(build(settings(tmp_path, compare=False)))) as client:
        for name in (f"corridor {n}" for n in range(24)):  # the quickest to draw
            taken = jpeg(scene(name).sized(320, 240).pixels)
            client.post(f"/enroll?place={name}", content=taken, headers={"content-type": "image/jpeg"})
        for candidates, n in product((0, 2), range(3)):
            taken = jpeg(scene(f"corridor {n}").seen_from(dx=0.7, turn=5).at("dusk").sized(320, 240).pixels)
            few, many = (
                client.post(
                    f"/query?top={top}&candidates={candidates}", content=taken, headers={"content-type": "image/jpeg"}
                ).json()
                for top in (10, 100)
            )
            assert few["matches"] == many["matches"][:10]
            assert (few["confidence"], few["places"][0]) == (many["confidence"], many["places"][0])


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


def test_it_does_not_depend_on_how_fast_images_were_enrolled(client: CheckedClient, runtime: Runtime) -> None:
    """While a robot pauses, the map compares its views with each other before it is whole."""
    places = ("mill lane", "station road", "rose garden", "market street", "castle park", "school lane", "harbour")
    answers = []
    for name, pauses in (("fast", ()), ("slow", range(4, 7)), ("halting", (5,))):
        for number, place in enumerate(places, 1):
            enrolled = client.post(
                f"/enroll?map={name}&place={place}", content=photo(scene(place)), headers={"content-type": "image/jpeg"}
            )
            enrolled.raise_for_status()
            if number in pauses:
                runtime.comparer.all()
        runtime.comparer.all()
        assert client.get(f"/maps/{name}").json()["decision"]["views_compared"] == len(places)
        taken = photo(scene("rose garden").seen_from(dx=0.4, turn=-3).behind("bus"))
        answer = client.post(f"/query?map={name}", content=taken, headers={"content-type": "image/jpeg"}).json()
        answers.append((answer["status"], answer["confidence"], answer["decision"]["features"]))
    assert answers[1:] == answers[:1] * 2


def test_a_covered_lens_is_not_where_it_was_covered_before(client: CheckedClient) -> None:
    """One frame of a map shows nothing: the only view of its place, and like every other covered lens."""
    grain = np.random.default_rng(7)
    first, later = (np.clip(grain.normal(8, 4, (240, 320, 3)), 0, 255).astype(np.uint8) for _ in range(2))
    looks = {f"{kind} {n}": scene(f"{kind} {n}").sized(320, 240).pixels for n in range(4) for kind in ("lane", "park")}
    for n in range(4):
        looks[f"corridor {n}"] = scene(f"corridor {n}").sized(320, 240).pixels
    for place, pixels in {**looks, "dock": first}.items():
        client.post(f"/enroll?map=covered&place={place}", content=jpeg(pixels), headers={"content-type": "image/jpeg"})
    for taken in (first, later):
        for more in ("", "&drive=robot", "&candidates=5"):
            answer = client.post(
                f"/query?map=covered{more}", content=jpeg(taken), headers={"content-type": "image/jpeg"}
            ).json()
            assert answer["matches"][0]["view"]["place"] == "dock"
            assert (answer["status"], answer["reason"]["code"]) == ("no_match", "poor-picture")
            assert (answer["confidence"], answer["nowhere"]) == (0, 1)
