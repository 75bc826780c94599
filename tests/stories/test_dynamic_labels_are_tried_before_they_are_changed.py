"""Who makes other labels dynamic sees first what that would leave out, and gets no less than was said."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.http.application import create_app
from tests.openapi import CheckedClient
from tests.sample_images import encoded
from tests.stories.importing import ended
from tests.stories.running import settings
from worker.runtime import build

JPEG = {"content-type": "image/jpeg"}
PERCENT = (0, 20, 50, 80, 100)


def enrolled(client: CheckedClient, preset: str) -> None:
    """Five views, in which one colour has more and more of the other's place."""
    assert client.put("/maps/m", json={"preset": preset}).status_code == 201
    for percent in PERCENT:
        image = np.full((96, 128, 3), (70, 130, 180), np.uint8)
        image[: 96 * (100 - percent) // 100] = (107, 142, 35)
        image[:, percent] += 1  # no two are alike
        assert client.post(f"/enroll?map=m&place={percent}", content=encoded(image, "png"), headers=JPEG).is_success


def shares(client: CheckedClient) -> dict[str, dict[str, float]]:
    """Shares of labels of each view, by its place."""
    views = client.get("/views?map=m").json()["views"]
    return {view["place"]: {one["label"]: one["share"] for one in view["description"]["labels"]} for view in views}


@pytest.mark.parametrize("preset", ["paper", "default"])
def test_a_preview_is_kept(tmp_path: Path, preset: str) -> None:
    with CheckedClient(create_app(build(settings(tmp_path)))) as client:
        enrolled(client, preset)
        before = shares(client)
        total = {name: sum(of.get(name, 0) for of in before.values()) for view in before.values() for name in view}
        label = max(total, key=lambda name: total[name])
        present = client.get("/maps/m").json()["recipe"]["dynamic"]
        wanted = [*present, label]

        preview = client.get("/maps/m/dynamic", params={"dynamic": ", ".join(wanted)}).json()

        assert preview["views"] == len(PERCENT)
        assert preview["after"] > preview["before"] == pytest.approx(0)
        named = {one["label"]: one for one in preview["labels"]}
        assert set(named) == set(wanted)
        assert named[label]["share"] == pytest.approx(np.mean([of.get(label, 0) for of in before.values()]), abs=0.01)
        lost = [one["share"] for one in preview["most"]]
        assert lost == sorted(lost, reverse=True)
        said = {one["view"]["place"]: one["share"] for one in preview["most"]}

        job = client.post("/maps/m/recipe", json={"preset": preset, "dynamic": wanted}).json()
        assert ended(client, job["id"])["state"] in ("done", "failed")
        views = client.get("/views?map=m").json()["views"]
        failed = [view["place"] for view in views if view["state"] == "failed"]
        assert len(failed) == preview["nothing_left"] == sum(share == 1 for share in said.values())
        for view in views:
            if view["state"] == "ready":
                left_out = 1 - view["description"]["static_share"]
                assert left_out <= said.get(view["place"], 0) + 0.01
                if preset == "paper":  # it has no margin, and no bound
                    assert left_out == pytest.approx(said.get(view["place"], 0), abs=0.01)


def test_what_cannot_be_tried_is_said(tmp_path: Path) -> None:
    with CheckedClient(create_app(build(settings(tmp_path)))) as client:
        enrolled(client, "paper")
        nothing: dict[str, Any] = client.get("/maps/m/dynamic?dynamic=").json()
        assert (nothing["after"], nothing["nothing_left"], nothing["labels"], nothing["most"]) == (0, 0, [], [])
        refused = client.get("/maps/m/dynamic?dynamic=moon").json()
        assert "moon" in refused["detail"]
        for wrong, status in (("", 422), ("dynamic=sky&limit=0", 422), ("dynamic=sky&share=1", 422)):
            assert client.get(f"/maps/m/dynamic?{wrong}").status_code == status
        assert client.get("/maps/none/dynamic?dynamic=sky").status_code == 404
        assert client.put("/maps/empty", json={}).status_code == 201
        assert client.get("/maps/empty/dynamic?dynamic=car").json()["views"] == 0
