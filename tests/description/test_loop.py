"""The worker's loop: whatever fails, no job that it claimed is left lying."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from schemas.errors import BadImage, Busy, StorageFailed, Unavailable
from tests.waiting import until
from worker.loop import Loop
from worker.service.trouble import StoringTrouble


class Disk:
    """Two jobs whose images cannot be read, and a store that refuses to put jobs back for a while."""

    def __init__(self, refusals: int) -> None:
        self.refusals, self.waiting, self.released = refusals, ["first", "second"], set[str]()

    def claim(self, worker: str, count: int, able: object) -> list[Any]:
        ids, self.waiting = self.waiting[:count], self.waiting[count:]
        view = SimpleNamespace(image=SimpleNamespace(sha256="0"))
        return [SimpleNamespace(job_id=one, view=SimpleNamespace(id=one, image=view.image)) for one in ids]

    def take_back(self, worker: str, held: Any, *, describe: bool) -> int:
        return 0

    def claim_map_job(self, worker: str, now: object, able: object) -> None:
        return None

    def image(self, view_id: str) -> bytes:
        raise StorageFailed("the disk does not answer")

    def release(self, claim: Any) -> None:
        if self.refusals:
            self.refusals -= 1
            raise StorageFailed("the database does not answer")
        self.released.add(claim.job_id)


def looping(store: Any) -> Loop:
    """A loop that has nothing but a store."""
    return Loop(
        jobs=store,
        views=store,
        pruning=cast(Any, SimpleNamespace(prune=lambda: 0)),
        scheduler=cast(Any, None),
        describers=cast(Any, SimpleNamespace(has=lambda recipe: True)),
        map_jobs={},
        decode=cast(Any, None),
        decoded=cast(Any, SimpleNamespace(take=lambda digest: None, clear=lambda: None)),
        name="worker",
        batch=1,
        trouble=StoringTrouble("descriptions", 0.01),
    )


@pytest.mark.parametrize("refusals", [0, 1, 3])
def test_a_job_whose_image_cannot_be_read_is_put_back_also_when_that_fails_at_first(refusals: int) -> None:
    disk = Disk(refusals)
    loop = looping(disk)
    loop.start()
    try:
        until(lambda: disk.released == {"first", "second"})
    finally:
        loop.stop()


class Unsure:
    """A store whose connection breaks in the first claim of either kind, once that was committed."""

    def __init__(self) -> None:
        self.free, self.running = {True, False}, set[bool]()  # of describe jobs, and of jobs of maps

    def _claim(self, describe: bool) -> None:
        if describe in self.free:
            self.free.remove(describe)
            self.running.add(describe)
            raise StorageFailed("the connection broke")

    def claim(self, worker: str, count: int, able: object) -> list[Any]:
        self._claim(True)
        return []

    def claim_map_job(self, worker: str, now: object, able: object) -> None:
        self._claim(False)

    def take_back(self, worker: str, held: Any, *, describe: bool) -> int:
        assert list(held) == []
        self.running.discard(describe)
        return 1


def test_what_was_claimed_in_a_transaction_of_unknown_end_is_taken_back() -> None:
    store = Unsure()
    loop = looping(store)
    loop.start()
    try:
        until(lambda: not store.free and not store.running)
    finally:
        loop.stop()


class Shortage:
    """A job whose image cannot be decoded for want of memory, a few times."""

    def __init__(self, failures: int) -> None:
        self.failures, self.attempts, self.waits = failures, 0, True
        self.failed: list[tuple[str, str]] = []
        self.released = 0

    def claim(self, worker: str, count: int, able: object) -> list[Any]:
        if not self.waits:
            return []
        self.waits = False
        self.attempts += 1
        view = SimpleNamespace(id="view", image=SimpleNamespace(sha256="0"))
        return [SimpleNamespace(job_id="job", view=view, attempts=self.attempts)]

    def claim_map_job(self, worker: str, now: object, able: object) -> None:
        return None

    def image(self, view_id: str) -> bytes:
        if self.attempts <= self.failures:
            raise MemoryError
        raise StorageFailed("far enough")

    def take_back(self, worker: str, held: Any, *, describe: bool) -> int:
        return 0

    def try_again(self, claim: Any) -> None:
        self.waits = True

    def release(self, claim: Any) -> None:
        self.released += 1

    def fail(self, claim: Any, code: str, detail: str, now: object) -> None:
        self.failed.append((code, detail))


@pytest.mark.parametrize(("failures", "attempts"), [(1, 2), (2, 3), (9, 3)])
def test_what_nobody_foresaw_is_tried_three_times_before_a_view_fails(
    failures: int, attempts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("worker.loop.RETRY_S", 0.01)
    jobs = Shortage(failures)
    loop = looping(jobs)
    loop.start()
    try:
        until(lambda: jobs.failed or jobs.released)
    finally:
        loop.stop()
    assert jobs.attempts == attempts
    if failures < attempts:
        assert not jobs.failed
    else:
        assert jobs.failed == [("internal", "describing it failed (MemoryError); the service's log has the details")]


@pytest.mark.parametrize("error", [Busy("all decoders are at work", 1), Unavailable("no process can be started", 5)])
def test_a_view_does_not_fail_for_what_the_service_is_busy_with(error: Busy, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("worker.loop.IDLE_S", 0.01)

    class Crowded(Shortage):
        def image(self, view_id: str) -> bytes:
            raise error

        def release(self, claim: Any) -> None:
            self.released += 1
            self.waits = True

    jobs = Crowded(0)
    loop = looping(jobs)
    loop.start()
    try:
        until(lambda: jobs.released > 5)
    finally:
        loop.stop()
    assert not jobs.failed


def test_an_image_that_is_to_blame_fails_at_once() -> None:
    class Bad(Shortage):
        def image(self, view_id: str) -> bytes:
            raise BadImage("undecodable-picture", "this image cannot be decoded: it ends too early")

    jobs = Bad(9)
    loop = looping(jobs)
    loop.start()
    try:
        until(lambda: jobs.failed)
    finally:
        loop.stop()
    assert (jobs.attempts, jobs.failed[0][0]) == (1, "undecodable-picture")
