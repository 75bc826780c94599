"""An operator reads `/metrics` of a real service, and what is drawn and alerted on exists there."""

from pathlib import Path

import httpx

from tests.http.test_metrics import samples
from tests.sample_images import photo
from tests.stories.running import RunningService

JPEG = {"content-type": "image/jpeg"}


def test_what_is_enrolled_and_what_waits_is_seen(tmp_path: Path) -> None:
    with RunningService(tmp_path, False, REVISIT_INLINE_WORKER="false") as service:
        httpx.post(f"{service.url}/enroll?map=m&wait=false", content=photo(), headers=JPEG, timeout=60)
        waiting = samples(httpx.get(f"{service.url}/metrics", timeout=60).text)
    with RunningService(tmp_path) as service:
        httpx.post(f"{service.url}/enroll?map=m", content=photo(), headers=JPEG, timeout=60)  # waits for the first call
        httpx.post(f"{service.url}/query?map=m", content=photo(), headers=JPEG, timeout=60)
        described = samples(httpx.get(f"{service.url}/metrics", timeout=60).text)

    queue = (("kind", "describe"), ("state", "waiting"))
    ready = (("map", "m"), ("state", "ready"))
    assert (waiting["revisit_jobs"][queue], described["revisit_jobs"][queue]) == (1, 0)
    assert waiting["revisit_oldest_waiting_job_age_seconds"][(("kind", "describe"),)] > 0
    assert (waiting["revisit_views"][ready], described["revisit_views"][ready]) == (0, 1)
    assert described["revisit_image_bytes"][(("map", "m"),)] == len(photo())
    assert described["revisit_database_bytes"][()] > 0
    assert 0 < described["revisit_disk_free_bytes"][()] <= described["revisit_disk_size_bytes"][()]
    assert described["revisit_index_lag_revisions"][(("map", "m"),)] == 0
    assert described["revisit_thread_alive"] == {(("thread", "encoder"),): 1, (("thread", "worker"),): 1}
    assert waiting["revisit_thread_alive"] == {(("thread", "encoder"),): 1}
    (build,) = described["revisit_build_info"]
    assert dict(build)["encoder"] == "color"
    assert {dict(labels)["stage"] for labels in described["revisit_stage_duration_seconds_count"]} >= {
        "decode",
        "encode",
        "search",
        "rerank",
        "verify",
    }
