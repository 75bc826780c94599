"""A place enrolled from landscape pictures is found with a phone held upright, which shows it in another shape."""

from dataclasses import replace
from pathlib import Path

import pytest

from app.http.application import create_app
from scenes import scene
from scenes.scene import Scene
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.stories.photos import jpeg
from worker.runtime import build

pytestmark = pytest.mark.one_database("it is about how views are ranked, not where they lie")

NAMES = ("mill lane", "the green", "school hill", "chapel row")


def held(look: Scene, *, upright: bool) -> bytes:
    """What one camera of 4:3 takes, held either way."""
    whole = replace(look, size=(640, 640)).pixels
    return jpeg(whole[:, 80:560] if upright else whole[80:560])


def test_it_finds_the_place_and_how_near_it_is(tmp_path: Path) -> None:
    sent = {"headers": {"content-type": "image/jpeg"}}
    with CheckedClient(create_app(build(Settings(data=tmp_path, encoder="compact", threads=1)))) as client:
        for name in NAMES:
            client.post(f"/enroll?place={name}", content=held(scene(name).seen_from(), upright=False), **sent)
        for name in NAMES:
            taken = held(scene(name).seen_from(dx=0.4, turn=2), upright=True)
            [best, next_best, *_] = client.post("/query", content=taken, **sent).json()["matches"]
            assert best["view"]["place"] == name
            assert best["score"] > 2 * next_best["score"]
            assert best["dense"]["scale"] == pytest.approx(1, abs=0.1)
