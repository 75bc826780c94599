"""The power goes while a recipe is tried in the shadow, and again just after the map was told to change over."""

from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest
from revisit_client import Revisit

from scenes import scene
from schemas.errors import NotFound
from tests.stories.photos import jpeg
from tests.stories.running import RunningService, settings
from worker.storage.store import open_store

PLACES = ("mill lane", "rose garden", "castle park")
LABELS = ["road", "sky", "building"]


def answer(service: RunningService, place: str) -> dict[str, Any]:
    """An answer without what differs from call to call."""
    sent = httpx.post(f"{service.url}/query", files={"image": jpeg(scene(place).pixels)}, timeout=60)
    told: dict[str, Any] = sent.raise_for_status().json()
    del told["timing_ms"], told["query"]["id"]
    return told


def test_a_shadow_survives_kills_and_the_switch_is_all_or_nothing(tmp_path: Path, database: str) -> None:
    """On PostgreSQL, which also searches the map."""
    searched = {"REVISIT_INDEX": "pgvector" if database == "postgresql" else "faiss"}
    with RunningService(tmp_path, True, **searched) as service, Revisit(service.url) as revisit:
        for place in PLACES:
            revisit.enroll(jpeg(scene(place).pixels), place=place)
        before = [answer(service, place) for place in PLACES]
        job = revisit.switch_recipe("default", labels=LABELS, dynamic=[], shadow=20)
        service.kill()

    with RunningService(tmp_path, True, **searched) as service, Revisit(service.url) as revisit:
        assert revisit.wait_for_job(job.id, timeout=60).kind == "shadow"
        assert [answer(service, place) for place in PLACES] == before
        shadow = revisit.shadow("default")
        assert shadow.table is not None
        assert (shadow.state, shadow.job, shadow.table.totals.views) == ("ready", job.id, len(PLACES))
        switched = revisit.switch_to_shadow("default")
        service.kill()

    with closing(open_store(settings(tmp_path).database_url, tmp_path)) as store:
        assert store.jobs.get(switched.id).state == "done"
        assert store.maps.get("default").description.id == shadow.recipe["id"]
        assert len(store.descriptions.since("default", 0).seqs) == len(PLACES)
        with pytest.raises(NotFound):
            store.jobs.shadow("default")

    with RunningService(tmp_path, True, **searched) as service:
        answers = [answer(service, place) for place in PLACES]
    assert {told["recipe"] for told in answers} == {shadow.recipe["id"]}
    assert [told["matches"][0]["view"]["place"] for told in answers] == list(PLACES)
