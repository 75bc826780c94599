"""One row of a map is damaged: it is named, mended in the background, and everything else is served meanwhile."""

import logging
import math
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import sqlalchemy as sa
from fastapi.testclient import TestClient

from app.http.application import create_app
from scenes import scene
from schemas.errors import Damaged
from tests.stories.photos import jpeg
from tests.stories.running import settings
from tests.waiting import until
from worker.runtime import Runtime, build
from worker.storage.tables import (
    APPEARANCES,
    CELLS,
    COMPARISONS,
    DESCRIPTIONS,
    JOBS,
    KEYPOINTS,
    MAPS,
    RECIPES,
    VECTORS,
    VIEWS,
)

NAMES = ("mill lane", "rose garden", "castle park", "fish market")
JPEG = {"content-type": "image/jpeg"}


@cache
def look(name: str) -> bytes:
    """A small JPEG of a drawn place."""
    return jpeg(cv2.resize(scene(name).pixels, (240, 180), interpolation=cv2.INTER_AREA))


class Sql(str):
    """A value that only SQL can say."""


class Town:
    """A running service whose map has four places, and a hand that damages its database."""

    def __init__(self, data: Path) -> None:
        self.data = data
        self.runtime: Runtime = build(settings(data, compare=False))
        self.client = TestClient(create_app(self.runtime))

    def __enter__(self) -> "Town":
        self.client.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.client.__exit__(None, None, None)

    def enroll(self) -> list[str]:
        ids = []
        for name in NAMES:
            given = {"map": "town", "place": name, "metadata": '{"colour":"red"}'}
            answer = self.client.post("/enroll", params=given, content=look(name), headers=JPEG)
            assert answer.status_code == 201, answer.text
            ids.append(answer.json()["view"]["id"])
        return ids

    def damage(self, table: sa.Table, where: str, **values: object) -> None:
        """Change a row behind the service's back, as a bad disk would: the checksum stays."""
        given = {name: value for name, value in values.items() if not isinstance(value, Sql)}
        changes = ", ".join(f"{name} = {f':{name}' if name in given else value}" for name, value in values.items())
        with self.engine().begin() as connection:
            changed = connection.execute(sa.text(f"UPDATE {table.name} SET {changes} WHERE {where}"), given)
            assert changed.rowcount == 1

    def engine(self) -> sa.Engine:
        """The database, without what the service does to its own connections."""
        return sa.create_engine(self.runtime.settings.database_url, poolclass=sa.pool.NullPool)

    def seq(self, view_id: str) -> int:
        return self.runtime.store.views.get(view_id).seq

    def query(self, name: str) -> dict[str, Any]:
        answer = self.client.post("/query?map=town", content=look(name), headers=JPEG)
        assert answer.status_code == 200, answer.text
        body: dict[str, Any] = answer.json()
        return body

    def found(self, name: str) -> list[str]:
        return [match["view"]["place"] for match in self.query(name)["matches"]]

    def settle(self, view_id: str) -> dict[str, Any]:
        """Wait until a view that was set aside is described again; one failed for good fails the test."""

        def ready() -> bool:
            waiting = self.runtime.store.jobs.count_waiting(redescriptions=True)  # first: the last one ends meanwhile
            record = self.runtime.store.views.get(view_id)
            assert waiting or record.state == "ready", record.failure
            return record.state == "ready"

        until(ready)
        body: dict[str, Any] = self.client.get(f"/views/{view_id}").json()
        return body


@pytest.fixture
def town(tmp_path: Path) -> Iterator[Town]:
    with Town(tmp_path) as open_town:
        yield open_town


def paused(town: Town) -> None:
    """Keep the loop from mending, so that what is served meanwhile can be looked at."""
    assert town.runtime.loop is not None
    town.runtime.loop.stop()


def flipped(body: bytes) -> bytes:
    return body[:-5] + bytes([body[-5] ^ 0x40]) + body[-4:]


BODIES = (VECTORS, APPEARANCES, CELLS, KEYPOINTS)


def body_of(town: Town, table: sa.Table, seq: int) -> bytes:
    with town.engine().connect() as connection:
        found = connection.scalar(sa.text(f"SELECT body FROM {table.name} WHERE seq = {seq}"))
    assert isinstance(found, bytes)
    return found


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "truncated": lambda body: body[: len(body) // 2],
    "emptied": lambda body: b"",
    "prolonged": lambda body: body + b"\0\0\0\0",
}


@pytest.mark.parametrize("table", BODIES, ids=lambda table: table.name)
def test_a_damaged_part_of_a_description(table: sa.Table, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    damaged_part(table, flipped, tmp_path, caplog)


@pytest.mark.slow
@pytest.mark.one_database("any other damage to a body is found by the same checksum")
@pytest.mark.parametrize("kind", DAMAGES)
@pytest.mark.parametrize("table", BODIES, ids=lambda table: table.name)
def test_a_part_of_a_description_that_is_damaged_otherwise(
    table: sa.Table, kind: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    damaged_part(table, DAMAGES[kind], tmp_path, caplog)


def damaged_part(
    table: sa.Table, damage: Callable[[bytes], bytes], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with Town(tmp_path) as town:
        ids = town.enroll()
        seq = town.seq(ids[1])
    with Town(tmp_path) as town:  # a new index, which reads everything
        paused(town)
        town.damage(table, f"seq = {seq}", body=damage(body_of(town, table, seq)))
        with caplog.at_level(logging.ERROR):
            answer = town.query("rose garden")
        assert sorted(match["view"]["place"] for match in answer["matches"]) == sorted(set(NAMES) - {"rose garden"})
        assert f"view {ids[1]} of map town: its {table.name} did not fit" in caplog.text
        view = town.client.get(f"/views/{ids[1]}").json()
        assert (view["state"], view["failure"]["code"]) == ("failed", "damaged")
        assert town.query("mill lane")["pending"] == 1
    with Town(tmp_path) as town:
        view = town.settle(ids[1])
        assert "failure" not in view or view["failure"] is None
        assert town.found("rose garden")[0] == "rose garden"
        assert town.query("mill lane")["pending"] == 0
        assert "Traceback" not in caplog.text


def test_a_view_whose_image_is_damaged_as_well_stays_failed_and_says_so(town: Town) -> None:
    ids = town.enroll()
    seq, digest = town.seq(ids[1]), town.runtime.store.views.get(ids[1]).image.sha256
    (town.data / "pictures" / digest[:2] / digest[2:4] / digest).write_bytes(b"")
    town.damage(CELLS, f"seq = {seq}", body=flipped(body_of(town, CELLS, seq)))
    assert sorted(town.found("rose garden")) == sorted(set(NAMES) - {"rose garden"})
    until(lambda: not town.runtime.store.jobs.count_waiting(redescriptions=True))
    view = town.client.get(f"/views/{ids[1]}").json()
    assert (view["state"], view["failure"]["code"]) == ("failed", "damaged")
    assert "is empty; enrol the image again" in view["failure"]["detail"]
    again = town.client.post("/enroll?map=town&place=rose garden", content=look("rose garden"), headers=JPEG)
    assert again.json()["view"]["state"] == "ready"
    assert town.found("rose garden")[0] == "rose garden"


def test_an_image_is_enrolled_although_what_it_resembles_cannot_be_told(
    town: Town, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def damaged(*_: object) -> None:
        raise Damaged("the settings of the map are damaged")

    monkeypatch.setattr(town.runtime.store.descriptions, "whole", damaged)
    ids = town.enroll()  # each is answered 201
    assert f"view {ids[0]} is not compared with its map: the settings of the map are damaged" in caplog.text


def test_vectors_that_are_no_numbers(town: Town) -> None:
    ids = town.enroll()
    for value in (math.nan, math.inf):
        seq, record = town.seq(ids[0]), town.runtime.store.maps.get("town")
        with town.runtime.store._database.writing() as connection:
            from worker.storage.checksums import of_body

            body = np.full(len(body_of(town, VECTORS, seq)) // 4, value, np.float32).tobytes()
            checksum = of_body(seq, record.description.id, body)  # as if it had been described so
            connection.execute(sa.update(VECTORS).where(VECTORS.c.seq == seq).values(body=body, checksum=checksum))
        town.runtime.catalogue.forget("town")
        town.query("mill lane")
        assert town.settle(ids[0])["state"] == "ready"
        assert town.found("mill lane")[0] == "mill lane"


def test_all_views_but_one_are_damaged_each_in_another_part(town: Town) -> None:
    ids = town.enroll()
    paused(town)
    town.found("mill lane")  # the index is in memory: only what is fetched for the ranking can show the damage
    for table, view_id in zip((APPEARANCES, CELLS, KEYPOINTS), ids[1:], strict=True):
        seq = town.seq(view_id)
        town.damage(table, f"seq = {seq}", body=flipped(body_of(town, table, seq)))
    assert town.found("rose garden") == ["mill lane"]


@pytest.mark.parametrize(("column", "value"), [("label_shares", b"no shares"), ("static_share", math.inf)])
def test_damaged_facts_of_a_description(town: Town, column: str, value: object) -> None:
    damaged_facts(town, column, value)


@pytest.mark.one_database("columns of PostgreSQL cannot hold what is not of their type")
@pytest.mark.parametrize(("column", "value"), [("nodes", 2**40), ("descriptor_count", "many")])
def test_facts_of_a_description_that_are_of_another_type(town: Town, column: str, value: object) -> None:
    damaged_facts(town, column, value)


def damaged_facts(town: Town, column: str, value: object) -> None:
    ids = town.enroll()
    paused(town)
    town.damage(DESCRIPTIONS, f"seq = {town.seq(ids[2])}", **{column: value})
    assert sorted(town.found("castle park")) == sorted(set(NAMES) - {"castle park"})
    listed = town.client.get("/views?map=town").json()["views"]
    assert [view["state"] for view in listed] == ["ready", "ready", "failed", "ready"]


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("place", "castle dark"),
        ("x", 12.0),
        ("metadata", "{"),
        ("metadata", '{"colour":"rod"}'),
        ("sha256", "0" * 64),
        ("sha256", "../../../../etc/no-such-file"),
        ("width", 0),
        ("format", "gif"),
    ],
)
def test_damaged_attributes_are_never_shown_and_can_be_given_again(town: Town, column: str, value: Any) -> None:
    damaged_attributes(town, column, value)


@pytest.mark.one_database("columns of PostgreSQL cannot hold what is not of their type")
@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("place", Sql("CAST(x'636173746c6520ff' AS TEXT)")),
        ("captured_at", "2026-13-41 99:00:00"),
        ("enrolled_at", b"\x00"),
        ("height", "tall"),
    ],
)
def test_attributes_that_are_of_another_type(town: Town, column: str, value: Any) -> None:
    damaged_attributes(town, column, value)


def damaged_attributes(town: Town, column: str, value: Any) -> None:
    ids = town.enroll()
    seq = town.seq(ids[2])
    town.damage(VIEWS, f"seq = {seq}", **{column: value})
    assert sorted(town.found("castle park")) == sorted(set(NAMES) - {"castle park"})
    listed = town.client.get("/views?map=town")
    assert listed.status_code == 200
    assert [view["state"] for view in listed.json()["views"]] == ["ready", "ready", "failed", "ready"]
    shown = town.client.get(f"/views/{ids[2]}").json()
    assert (shown["state"], shown["failure"]["code"]) == ("failed", "damaged")
    assert "place" not in shown or shown["place"] is None
    assert town.client.get("/places?map=town").status_code == 200
    assert town.client.get("/maps").status_code == 200

    patched = town.client.patch(f"/views/{ids[2]}", json={"place": "castle park"})
    assert patched.json()["type"] == "urn:revisit:problem:damaged"
    assert "enrol its image again" in patched.json()["detail"]
    again = town.client.post("/enroll?map=town&place=castle park", content=look("castle park"), headers=JPEG)
    if column == "sha256":  # it is not known any more what it is an image of
        assert again.status_code == 201
        assert town.client.delete(f"/views/{ids[2]}").status_code == 200
    else:
        assert again.status_code == 200, again.text
        assert town.settle(ids[2])["place"] == "castle park"
    assert town.found("castle park")[0] == "castle park"


def test_a_damaged_state_is_set_right(town: Town, caplog: pytest.LogCaptureFixture) -> None:
    ids = town.enroll()
    town.damage(VIEWS, f"seq = {town.seq(ids[2])}", state="reday")
    with caplog.at_level(logging.ERROR):
        town.found("castle park")
    assert f"view {ids[2]}: its state 'reday' is none" in caplog.text
    assert town.found("castle park")[0] == "castle park"


def test_an_image_that_is_enrolled_again_heals_its_damaged_attributes(town: Town) -> None:
    ids = town.enroll()
    town.damage(VIEWS, f"seq = {town.seq(ids[0])}", place="hill lane", width=3)
    town.found("mill lane")
    answer = town.client.post("/enroll?map=town&place=mill lane", content=look("mill lane"), headers=JPEG)
    assert answer.status_code == 200, answer.text
    assert town.settle(ids[0])["place"] == "mill lane"
    assert town.found("mill lane")[0] == "mill lane"


def test_damaged_settings_of_a_map_and_damaged_comparisons(town: Town, caplog: pytest.LogCaptureFixture) -> None:
    ids = town.enroll()
    town.runtime.comparer.all()
    town.damage(COMPARISONS, f"seq = {town.seq(ids[0])}", same_spot="[1,")
    town.damage(COMPARISONS, f"seq = {town.seq(ids[1])}", level=1e300)
    assert town.found("mill lane")[0] == "mill lane"
    assert town.client.get("/maps/town").json()["decision"]["views_compared"] >= 3
    for broken in ({"calibration": "{"}, {"ranking": "no json"}):
        with caplog.at_level(logging.ERROR):
            town.damage(MAPS, "name = 'town'", **broken)
            assert town.found("mill lane")[0] == "mill lane"
            assert [one["name"] for one in town.client.get("/maps").json()["maps"]] == ["town"]
        assert "map town: its stored settings do not fit" in caplog.text


def test_a_damaged_recipe_stops_its_own_maps_only(town: Town) -> None:
    town.enroll()
    made = town.client.put("/maps/other", json={"dynamic": ["car"]})
    assert made.status_code == 201, made.text
    recipe = town.runtime.store.maps.get("town").description.id
    town.damage(RECIPES, f"id = '{recipe}'", body="{}")
    assert [one["name"] for one in town.client.get("/maps").json()["maps"]] == ["other"]
    answer = town.client.post("/query?map=town", content=look("mill lane"), headers=JPEG)
    assert (answer.status_code, answer.json()["type"]) == (500, "urn:revisit:problem:damaged")
    assert recipe in answer.json()["detail"]


def test_a_damaged_job_is_listed_as_that(town: Town) -> None:
    town.enroll()
    last = town.client.get("/jobs").json()["jobs"][0]
    town.damage(JOBS, "number = 4", kind="descrobe", finished_at="tomorrow")
    listed = {job["id"]: job for job in town.client.get("/jobs").json()["jobs"]}
    assert listed[last["id"]]["state"] == "failed"
    assert [job["state"] for key, job in listed.items() if key != last["id"]] == ["done"] * 3


def test_a_damaged_row_deletes_no_file_that_is_not_an_image(town: Town, tmp_path: Path) -> None:
    bystander = tmp_path / "bystander"
    bystander.write_text("not of this service")
    view = town.enroll()[2]
    town.damage(VIEWS, f"seq = {town.seq(view)}", sha256=str(bystander))
    before = sorted(tmp_path.rglob("*"))

    assert town.client.delete(f"/views/{view}").status_code == 200
    assert bystander.read_text() == "not of this service"
    assert sorted(tmp_path.rglob("*")) == before
