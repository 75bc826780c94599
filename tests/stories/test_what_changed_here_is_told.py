"""A facilities app asks what changed at a place since it was enrolled: what is gone, new or moved; and a picture."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import httpx
import numpy as np
import pytest
from fastapi.testclient import TestClient
from PIL import Image as PilImage
from revisit_client import Revisit, RevisitProblem

from app.http.application import create_app
from scenes import Scene, scene
from scenes.refurnishing import Piece, furnished
from tests.stories.photos import jpeg, photo
from tests.stories.running import RunningService, settings
from worker.runtime import build
from worker.service.changes import ChangeService

pytestmark = pytest.mark.one_database("images are compared; what is kept of it is read from both in tests/storage")

HALL = scene("corridor refurnished")
CUPBOARD, CHAIR = Piece("cupboard", -0.8, 4.0, 1), Piece("chair", 0.7, 3.6, 2)
JPEG = {"content-type": "image/jpeg"}


def taken(seen: Scene, *pieces: Piece) -> bytes:
    return jpeg(furnished(seen, pieces)[0])


def where(seen: Scene, piece: Piece) -> tuple[float, float]:
    """(x, y) of the middle of a piece of furniture, in fractions of the longer side."""
    [mask] = furnished(seen, [piece])[1]
    rows, columns = np.nonzero(mask)
    return (columns.min() + columns.max()) / 2 / 640, (rows.min() + rows.max()) / 2 / 640


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    data: Path = tmp_path_factory.mktemp("hall")
    with RunningService(data, REVISIT_ENCODER="compact") as service:
        yield service.url


@pytest.fixture(scope="module")
def client(url: str) -> Iterator[Revisit]:
    with Revisit(url) as revisit:
        revisit.enroll(taken(HALL, CUPBOARD), map="house", place="hall")
        for name in ("mill lane", "rose garden"):
            revisit.enroll(photo(scene(name)), map="house", place=name)
        yield revisit


def test_a_cupboard_that_is_gone_is_told_where_it_stood(client: Revisit) -> None:
    answer = client.query(taken(HALL.seen_from(dx=0.1, turn=1)), map="house", changes=True)

    assert answer.matches[0].view.place == "hall"
    assert answer.changes is not None
    assert (answer.changes.status, answer.changes.since) == ("compared", answer.matches[0].view.id)
    [gone] = answer.changes.changes
    assert (gone.kind, gone.now) == ("gone", None)
    assert gone.then is not None
    assert gone.then.centre == pytest.approx(where(HALL, CUPBOARD), abs=0.08)
    assert answer.changes.compared > 0.7


def test_a_chair_that_is_new_is_told_and_the_cupboard_that_stayed_is_not(client: Revisit) -> None:
    seen = HALL.seen_from(turn=-1)
    answer = client.query(taken(seen, CUPBOARD, CHAIR), map="house", changes=True)

    assert answer.changes is not None
    [new] = answer.changes.changes
    assert (new.kind, new.then) == ("new", None)
    assert new.now is not None
    assert new.now.centre == pytest.approx(where(seen, CHAIR), abs=0.08)


@pytest.mark.parametrize("light", ["noon", "overcast", "dusk"])
def test_in_other_light_nothing_changed(client: Revisit, light: Any) -> None:
    answer = client.query(taken(HALL.at(light).seen_from(dx=0.15), CUPBOARD), map="house", changes=True)

    assert answer.changes is not None
    assert (answer.changes.status, answer.changes.changes) == ("compared", [])


def test_a_person_who_stands_there_is_no_change(client: Revisit) -> None:
    answer = client.query(taken(HALL.behind("person"), CUPBOARD), map="house", changes=True)

    assert answer.changes is not None
    assert answer.changes.changes == []


def test_two_views_are_compared_and_drawn(client: Revisit) -> None:
    then = client.enroll(taken(HALL, CUPBOARD), map="later", place="hall").view.id
    now = client.enroll(taken(HALL, CHAIR), map="later", place="hall").view.id
    found = client.changes(now, since=then)

    assert {(one.kind, one.instead is None) for one in found.changes} <= {("gone", False), ("new", False)}
    assert [one.kind for one in found.changes].count("gone") == 1
    assert found.links == {"drawing": f"/views/{now}/changes.png?since={then}"}
    with PilImage.open(io.BytesIO(client.draw_changes(now, since=then))) as sheet:
        assert sheet.width == 1280
    back = client.changes(then, since=now)
    assert len(back.changes) == len(found.changes)


def test_photos_are_compared_once_for_words_and_drawing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    compared = Mock(side_effect=ChangeService.compare)
    monkeypatch.setattr(ChangeService, "compare", lambda *given: compared(*given))
    with TestClient(create_app(build(settings(tmp_path, compare=False)))) as service:
        then, now = (
            service.post("/enroll?map=house&place=hall", content=taken(HALL, piece), headers=JPEG).json()["view"]["id"]
            for piece in (CUPBOARD, CHAIR)
        )
        for _ in range(2):
            found = service.get(f"/views/{now}/changes?since={then}").json()
            assert service.get(found["links"]["drawing"]).status_code == 200
        assert compared.call_count == 1
        service.get(f"/views/{then}/changes?since={now}").raise_for_status()
        assert compared.call_count == 2
        service.delete(f"/views/{then}").raise_for_status()
        assert service.get(f"/views/{now}/changes?since={then}").status_code == 404


def test_the_drawing_of_a_query_is_kept_and_another_has_a_version(client: Revisit, url: str) -> None:
    answer = client.query(taken(HALL), map="house", changes=True)
    assert answer.changes is not None
    assert answer.changes.links == {"drawing": f"/queries/{answer.query.id}/changes.png"}
    assert client.draw_changes_of_query(answer.query.id)[:4] == b"\x89PNG"

    one, other = (view.id for view in client.views("house", limit=2))
    with httpx.Client(base_url=url, timeout=60) as plain:
        drawn = plain.get(f"/views/{one}/changes.png?since={other}")
        again = plain.get(f"/views/{one}/changes.png?since={other}", headers={"If-None-Match": drawn.headers["etag"]})
    assert (drawn.status_code, again.status_code) == (200, 304)


def test_a_service_that_keeps_no_queries_answers_them_all_the_same(tmp_path: Path) -> None:
    with TestClient(create_app(build(settings(tmp_path, explanations=0)))) as service:
        for piece in (CUPBOARD, CHAIR):
            service.post("/enroll?place=hall", content=taken(HALL, piece), headers=JPEG).raise_for_status()
        answer = service.post("/query?explain=true&changes=true", content=taken(HALL), headers=JPEG).json()

    first = answer["matches"][0]
    assert first["links"]["explanation"] is None
    assert first["verification"]["pairs"]
    changes = answer["changes"]
    assert (changes["status"], changes["changes"], changes["links"]) == ("image-not-kept", [], {})
    assert "the latest 0 are kept until a restart (REVISIT_EXPLANATIONS)" in changes["detail"]


def test_a_view_with_another_name_is_drawn_with_it(client: Revisit, url: str) -> None:
    then, now = (client.enroll(taken(HALL, piece), map="named", place="hall").view.id for piece in (CUPBOARD, CHAIR))
    query = client.query(taken(HALL, CUPBOARD), map="named", changes=True).query.id
    with httpx.Client(base_url=url, timeout=60) as plain:
        drawn = plain.get(f"/views/{now}/changes.png?since={then}")
        of_query = client.draw_changes_of_query(query)
        for view in (then, now):
            client.patch(view, place="corridor")
        again = plain.get(f"/views/{now}/changes.png?since={then}", headers={"If-None-Match": drawn.headers["etag"]})
    assert again.status_code == 200
    assert again.content != drawn.content
    assert client.draw_changes_of_query(query) != of_query


def test_photos_of_different_places_are_not_compared(client: Revisit) -> None:
    views = {view.place: view.id for view in client.views("house")}
    found = client.changes(views["mill lane"], since=views["rose garden"])

    assert (found.status, found.changes, found.compared) == ("not-aligned", [], 0)
    assert found.detail is not None
    assert "12 are needed" in found.detail


def test_a_query_that_matches_nothing_says_so(client: Revisit) -> None:
    answer = client.query(photo(scene("never enrolled")), map="house", changes=True)

    assert answer.changes is not None
    assert answer.status != "no_match" or answer.changes.status == "no-match"


def test_a_query_that_does_not_ask_is_told_nothing(client: Revisit) -> None:
    assert client.query(taken(HALL), map="house").changes is None


def test_what_changed_is_fetched_after_an_explained_query(client: Revisit) -> None:
    answer = client.query(taken(HALL.seen_from(dx=0.1, turn=1)), map="house", explain=True)
    assert answer.changes is None
    found = client.changes_of_query(answer.query.id)
    assert [one.kind for one in found.changes] == ["gone"]
    assert found.links == {"drawing": f"/queries/{answer.query.id}/changes.png"}
    with pytest.raises(RevisitProblem, match="explained query"):
        client.changes_of_query("0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b90")


def test_views_that_cannot_be_compared_are_refused(client: Revisit, url: str) -> None:
    one = next(client.views("house")).id
    elsewhere = client.enroll(taken(HALL), map="elsewhere").view.id
    for since, told in ((one, "is the view itself"), (elsewhere, "is a view of the map 'elsewhere'")):
        with pytest.raises(RevisitProblem, match=told):
            client.changes(one, since=since)
    with pytest.raises(RevisitProblem, match="there is no view"):
        client.changes(one, since="unknown")
    with httpx.Client(base_url=url, timeout=60) as plain:
        assert plain.get(f"/views/{one}/changes").status_code == 422


def test_a_map_that_keeps_no_images_has_no_photo_to_compare(client: Revisit, url: str) -> None:
    with httpx.Client(base_url=url, timeout=60) as plain:
        plain.put("/maps/bare", json={})
        plain.patch("/maps/bare", json={"keep_images": False})
    views = [client.enroll(taken(HALL, *pieces), map="bare", place="hall").view.id for pieces in ((), (CUPBOARD,))]

    answer = client.query(taken(HALL, CHAIR), map="bare", changes=True)
    assert answer.changes is not None
    if answer.status != "no_match":
        assert (answer.changes.status, answer.changes.links) == ("image-not-kept", {})
        assert "keeps no images" in str(answer.changes.detail)
    with pytest.raises(RevisitProblem, match="keeps no images"):
        client.changes(views[0], since=views[1])
