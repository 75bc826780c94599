"""A user looks for views with much of something in them, by the labels of the map."""

from pathlib import Path
from typing import Any

import numpy as np

from app.http.application import create_app
from tests.openapi import CheckedClient
from tests.sample_images import encoded
from tests.stories.running import settings
from worker.runtime import build

JPEG = {"content-type": "image/jpeg"}


def test_most_of_it_first(tmp_path: Path) -> None:
    with CheckedClient(create_app(build(settings(tmp_path)))) as client:
        for percent in (20, 80, 50, 0, 100):
            image = np.full((96, 128, 3), (70, 130, 180), np.uint8)  # sky above, grass below
            image[: 96 * (100 - percent) // 100] = (107, 142, 35)
            image[:, percent] += 1  # no two are alike
            assert client.post(f"/enroll?map=m&place={percent}", content=encoded(image, "png"), headers=JPEG).is_success

        def found(words: str, **more: str) -> list[Any]:
            answer = client.get("/views", params={"map": "m", "words": words, **more})
            assert answer.status_code == 200, answer.text
            return list(answer.json()["views"])

        shares = {
            view["place"]: {one["label"]: one["share"] for one in view["description"]["labels"]}
            for view in client.get("/views?map=m").json()["views"]
        }
        one, other = sorted({label for labels in shares.values() for label, share in labels.items() if share > 0.3})[:2]

        ranked = [shares[view["place"]].get(one, 0) for view in found(one)]
        assert ranked == sorted(ranked, reverse=True)
        assert len(ranked) == sum(one in labels for labels in shares.values()) > 1
        together = [view["place"] for view in found(f"{one}+{other}")]
        assert together[0] == max(shares, key=lambda place: shares[place].get(one, 0) * shares[place].get(other, 0))
        assert [view["place"] for view in client.get(f"/views?map=m&words={one}+{other}").json()["views"]] == together
        assert [view["place"] for view in found(one, place="80")] == ["80"]

        pages: list[str] = []
        cursor: dict[str, str] = {}
        while True:
            page = client.get("/views", params={"map": "m", "words": f"{one},{other}", "limit": "2", **cursor}).json()
            pages += [view["id"] for view in page["views"]]
            if page["next"] is None:
                break
            cursor = {"cursor": page["next"]}
        assert pages == [view["id"] for view in found(f"{one},{other}")]
        assert len(set(pages)) == len(pages) == 5

        refused = client.get("/views?map=m&words=moon").json()
        assert "moon" in refused["detail"]
        assert one in refused["detail"]
        alone = f"map=m&words={one}"
        for wrong in ("words=moon", f"{alone}&sort=enrolled_at", f"{alone}&state=ready", "map=m&words="):
            assert client.get(f"/views?{wrong}").status_code == 422
        assert client.get(f"/views?map=m&words={one}&cursor=bm8").status_code == 422
        assert client.get(f"/views?map=nowhere&words={one}").status_code == 404
