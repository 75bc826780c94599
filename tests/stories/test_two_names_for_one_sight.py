"""Places that look alike to the map share the probability that a photo shows one of them."""

from collections.abc import Iterator

import pytest

from app.http.application import create_app
from scenes import scene
from scenes.scene import Lighting
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.stories.photos import photo
from tests.stories.test_decisions_a_robot_can_act_on import PLACES, enroll, query, settled
from worker.runtime import build

pytestmark = pytest.mark.one_database("it is about how views are ranked, not where they lie")

LIGHTS: tuple[Lighting, ...] = ("noon", "overcast")
NAMES = ("hall, floor 1", "hall, floor 2", "hall, floor 3")


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CheckedClient]:
    data = tmp_path_factory.mktemp("data")
    with CheckedClient(create_app(build(Settings(data=data, encoder="compact", threads=1)))) as opened:
        yield opened


@pytest.mark.parametrize("count", [2, 3])
def test_who_stands_at_one_of_them_is_not_nowhere(client: CheckedClient, count: int) -> None:
    house, hall = f"house-{count}", scene("west corridor")
    for name in PLACES:
        enroll(client, house, name, photo(scene(name)))
    for step, name in enumerate(NAMES[:count]):
        enroll(client, house, name, photo(hall.seen_from(dx=0.01 * step)))
    settled(client, house)

    for light in LIGHTS:
        answer = query(client, house, photo(hall.seen_from(dx=0.3, turn=3).at(light)))
        assert (answer["status"], answer["reason"]["code"]) == ("ambiguous", "look-alike")
        halls, others = answer["places"][:count], answer["places"][count:]
        assert {place["place"] for place in halls} == set(NAMES[:count])
        assert all(0.9 / count < place["probability"] <= 1 / count for place in halls)
        assert all(place["probability"] < 0.01 for place in others)
        assert answer["nowhere"] < 0.05
