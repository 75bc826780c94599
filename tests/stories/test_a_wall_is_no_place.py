"""A phone is pointed at a page, a wall or the sky: that a map has one view of such a kind makes it no match."""

from collections import Counter
from collections.abc import Iterator

import pytest

from app.http.application import create_app
from scenes import scene
from scenes.placeless import KINDS, placeless
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.stories.photos import jpeg, photo
from tests.stories.test_decisions_a_robot_can_act_on import PLACES, enroll, query, settled
from worker.description.describers import Describers
from worker.runtime import build

pytestmark = pytest.mark.one_database("it is about how views are ranked, not where they lie")

ENROLLED, OTHER = 100, 101
"""Seeds; neither is among those that ship described."""


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[CheckedClient]:
    """A map of six places and one picture of each kind that shows none."""
    data = tmp_path_factory.mktemp("data")
    with CheckedClient(create_app(build(Settings(data=data, encoder="compact", threads=1)))) as opened:
        for name in PLACES:
            enroll(opened, "town", name, photo(scene(name)))
        for kind in KINDS:
            enroll(opened, "town", kind, jpeg(placeless(kind, ENROLLED)))
        settled(opened, "town")
        yield opened


def verdicts(client: CheckedClient) -> Counter[str]:
    """What is said of pictures of each kind that are not enrolled."""
    return Counter(query(client, "town", jpeg(placeless(kind, OTHER)))["status"] for kind in KINDS)


def test_another_of_the_kind_is_not_matched_and_without_the_impostors_it_is(
    client: CheckedClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = verdicts(client)
    assert found["matched"] == 0
    assert found["no_match"] > 3 * found["ambiguous"]

    monkeypatch.setattr(Describers, "impostors", lambda describers, recipe: None)
    assert verdicts(client)["matched"] > 0


def test_the_image_itself_is_found_again(client: CheckedClient) -> None:
    for kind in KINDS:
        again = placeless(kind, ENROLLED)[5:, 9:]
        answer = query(client, "town", jpeg(again))
        assert (answer["status"], answer["places"][0]["place"]) == ("matched", kind)


def test_what_hinders_it_is_said(client: CheckedClient) -> None:
    reasons = [query(client, "town", jpeg(placeless(kind, OTHER)))["reason"] for kind in KINDS]
    assert "hardly from pictures that show no place" in " ".join(reason["detail"] for reason in reasons)
