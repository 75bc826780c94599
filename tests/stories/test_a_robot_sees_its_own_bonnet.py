"""A camera that shows part of its vehicle in every image recognises places as if it did not."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from app.http.application import create_app
from scenes import scene
from scenes.carried import bars, bonnet
from scenes.geometry import Pixels
from schemas.settings import Settings
from tests.openapi import CheckedClient
from tests.stories.photos import jpeg
from worker.runtime import build
from worker.service.explanations import Explained, headline
from worker.service.sheets import cells_of

pytestmark = pytest.mark.one_database("tests/search holds that both kinds of index draw the same sample")

JPEG = {"content-type": "image/jpeg"}
FIRST, SECOND = ("mill", "station", "rose", "market"), ("lane", "road", "park")
PLACES = tuple(f"{first} {second}" for first in FIRST for second in SECOND)
NEVER_ENROLLED = ("foreign street", "far away")


def queried(client: TestClient, name: str, carried: Callable[[Pixels], Pixels]) -> dict[str, Any]:
    taken = jpeg(carried(scene(name).seen_from(dx=0.5, ahead=0.4, turn=4).pixels))
    answer: dict[str, Any] = client.post("/query?map=drive", content=taken, headers=JPEG).raise_for_status().json()
    return answer


def wall(light: float) -> Pixels:
    """Bare, and seen with the noise of a camera."""
    grain = np.random.default_rng(int(light)).normal(light, 3, (480, 640, 3))
    return np.clip(grain, 0, 255).astype(np.uint8)


def large_bonnet(pixels: Pixels) -> Pixels:
    return bonnet(pixels, 0.3)


@pytest.mark.parametrize("carried", [large_bonnet, bars], ids=["bonnet", "bars"])
def test_what_the_camera_carries_along_says_nothing_of_a_place(
    tmp_path: Path, carried: Callable[[Pixels], Pixels]
) -> None:
    runtime = build(Settings(data=tmp_path, encoder="compact", threads=1, compare=False))
    with CheckedClient(create_app(runtime)) as client:
        for name in PLACES:
            taken = jpeg(carried(scene(name).pixels))
            client.post(f"/enroll?map=drive&place={name}", content=taken, headers=JPEG).raise_for_status()
        runtime.comparer.all()

        known = [queried(client, name, carried) for name in PLACES[::2]]
        assert [one["places"][0]["place"] for one in known] == list(PLACES[::2])
        assert [one["status"] for one in known] == ["matched"] * len(known)
        unknown = [queried(client, name, carried) for name in NEVER_ENROLLED]
        assert [one["status"] for one in unknown] == ["no_match"] * len(unknown)
        assert all(one["query"]["fixed_share"] > 0.2 for one in known)

        for name in PLACES[:3]:  # what is explained is what ranked: without the bonnet of the views as well
            taken = jpeg(carried(scene(name).seen_from(dx=0.5, ahead=0.4, turn=4).pixels))
            told = runtime.services.query.query(taken, "drive")
            explained = Explained.of(told.image, told.results.query, told.results, headline(told.decision))
            for rank, one in enumerate(told.results.views[:3]):
                kept = runtime.store.descriptions.cells([one.seq], told.results.recipe.description.id)
                shown = cells_of(explained, one, kept[one.seq])
                assert shown is not None
                assert shown.of_query().ravel() == pytest.approx(told.results.ranking.cells[rank], abs=1e-5)

        # A wall close by is the same with the bonnet before it wherever it stands.
        client.post("/enroll?map=drive&place=wall", content=jpeg(carried(wall(170))), headers=JPEG).raise_for_status()
        for light in (170, 90, 6):
            seen = client.post("/query?map=drive", content=jpeg(carried(wall(light))), headers=JPEG).json()
            assert (seen["status"], seen["reason"]["code"]) == ("no_match", "poor-picture")

        bare = queried(client, PLACES[0], np.asarray)
        assert bare["query"]["fixed_share"] < 0.05  # the camera of somebody else, which carries nothing
        assert bare["places"][0]["place"] == PLACES[0]
