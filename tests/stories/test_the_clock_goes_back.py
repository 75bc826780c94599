"""The clock of a robot is set back and forth while it drives: what it just saw is still left out of a search."""

from datetime import datetime
from pathlib import Path

import httpx
import pytest

from tests.preloading import compiled
from tests.sample_images import photo
from tests.stories.importing import ZIP, ended, photos, zipped
from tests.stories.running import RunningService, worker

JPEG = {"content-type": "image/jpeg"}
HOUR_S = 3600


@pytest.mark.parametrize("jump_s", [-HOUR_S, 100 * 365 * 24 * HOUR_S], ids=["back", "forward"])
def test_the_view_of_a_moment_ago_is_not_matched_after_a_jump_of_the_clock(tmp_path: Path, jump_s: int) -> None:
    clock = tmp_path / "clock"
    clock.write_text("0")
    library = compiled(Path(__file__).with_name("faked_clock.c"), tmp_path)
    with (
        RunningService(tmp_path / "data", LD_PRELOAD=str(library), FAKED_CLOCK=str(clock)) as service,
        httpx.Client(base_url=service.url, timeout=30) as client,
    ):

        def enroll(seed: int, key: str) -> dict[str, str]:
            answer = client.post("/enroll", content=photo(seed=seed), headers=JPEG | {"Idempotency-Key": key})
            assert answer.status_code == 201, answer.text
            view: dict[str, str] = answer.json()["view"]
            return view

        def query(seed: int) -> list[str]:
            answer = client.post("/query?exclude_last=30s", content=photo(seed=seed), headers=JPEG)
            assert answer.status_code == 200, answer.text
            return [match["view"]["id"] for match in answer.json()["matches"]]

        before = enroll(1, "first")
        clock.write_text(str(jump_s))
        after = enroll(2, "second")
        jumped = datetime.fromisoformat(after["enrolled_at"]) - datetime.fromisoformat(before["enrolled_at"])
        assert abs(jumped.total_seconds() - jump_s) < 60, "the clock of the service did not jump"

        # Both were enrolled within the last seconds: matching either would close a loop that the robot never drove.
        assert query(1) == []
        assert query(2) == []
        found = client.post("/query", content=photo(seed=1), headers=JPEG).json()
        assert found["matches"][0]["view"]["id"] == before["id"]

        # Ids and pages keep the order of enrolment, and a call is still remembered.
        assert before["id"] < after["id"]
        assert [view["id"] for view in client.get("/views").json()["views"]] in (
            [before["id"], after["id"]],
            [after["id"], before["id"]],
        )
        again = client.post("/enroll", content=photo(seed=1), headers=JPEG | {"Idempotency-Key": "first"})
        assert again.headers["idempotent-replayed"] == "true"
        assert client.get("/readyz").status_code == 200


def test_an_import_by_a_worker_whose_clock_is_behind_tells_what_it_enrolled(tmp_path: Path) -> None:
    clock = tmp_path / "clock"
    clock.write_text(str(-HOUR_S))
    library = compiled(Path(__file__).with_name("faked_clock.c"), tmp_path)
    data = tmp_path / "data"
    with (
        RunningService(data, False, REVISIT_INLINE_WORKER="false") as service,
        worker(data, LD_PRELOAD=str(library), FAKED_CLOCK=str(clock)),
        httpx.Client(base_url=service.url, timeout=30) as client,
    ):
        job = client.post("/maps/walk/imports", content=zipped(photos(3)), headers=ZIP).json()["id"]
        told = ended(client, job)["result"]
        assert (told["enrolled"], told["already_there"]) == (3, 0)
