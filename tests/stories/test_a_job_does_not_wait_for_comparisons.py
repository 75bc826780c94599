"""A recording is imported at once, though the views of a map are being compared in the background."""

import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from schemas.imports import ImportOptions
from schemas.records import ViewAttributes
from tests.sample_images import photo
from tests.stories.importing import photos, zipped
from tests.stories.running import settings
from tests.waiting import PATIENCE_S, until
from worker.runtime import build


def test_a_portion_of_comparisons_ends_when_a_job_waits(tmp_path: Path) -> None:
    runtime = build(settings(tmp_path, compare=False))
    runtime.start()
    try:
        for number in range(5):
            runtime.services.enroll.enroll(photo(number), "town", ViewAttributes(), patience_s=PATIENCE_S)
        rests: list[float] = []

        def rest(seconds: float) -> bool:
            rests.append(seconds)
            return len(rests) >= 2

        assert runtime.comparer.step(rest=rest)
        assert runtime.store.comparisons.levels("town").compared == 2
        assert rests[:-1] == [0, 0]
        assert rests[-1] > 0
        assert runtime.comparer.step(rest=lambda seconds: False)
        assert runtime.store.comparisons.levels("town").compared == 5
    finally:
        runtime.stop()


def test_an_import_ends_the_rest_between_comparisons(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    resting, woken = threading.Event(), threading.Event()

    def compare(busy: bool, rest: Callable[[float], bool]) -> bool:
        if woken.is_set():
            return False
        resting.set()
        if rest(10 * PATIENCE_S):
            woken.set()
        return True

    monkeypatch.setattr("worker.runtime.building.idle_work", lambda *_: compare)
    runtime = build(settings(tmp_path))
    runtime.start()
    try:
        assert resting.wait(PATIENCE_S)
        upload = runtime.services.imports.receive(0)
        upload.write(zipped(photos(3)))
        assert runtime.services.imports.check(upload, ImportOptions()) == 3
        job = runtime.services.imports.accept(upload, "town", ImportOptions())
        until(lambda: runtime.store.jobs.get(job.id).state == "done")
        assert woken.is_set()
    finally:
        runtime.stop()
