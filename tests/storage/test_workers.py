"""Signs of life: who gives none loses its jobs, whatever the clocks say, and nothing is described twice."""

import subprocess
import sys
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from unittest.mock import Mock

import pytest

from schemas.errors import DiskFull, LeaseLost
from schemas.records import WorkerRecord
from tests.storage.material import NOW, enroll, finish
from worker.service import attendance
from worker.service.attendance import ROUNDS, Attendance, this_process
from worker.storage.store import SqlStore

FAR = replace(this_process("worker", "color"), name="far", host="another machine/pid:[1]")


def watching(
    store: SqlStore, freed: Mock | None = None, me: WorkerRecord | None = None, *, works: bool = True
) -> Attendance:
    """The attendance of a worker, or of a process without one, whose rounds a test makes by itself."""
    return Attendance(
        store.workers,
        me or this_process("worker", "color"),
        working=(lambda: True) if works else None,
        every_s=3600,
        each_round=lambda: None,
        on_freed=freed or Mock(),
    )


def test_the_jobs_of_a_silent_worker_go_back_and_its_late_description_is_refused(store: SqlStore) -> None:
    view = enroll(store, "gate").view
    store.workers.beat(FAR, NOW)
    [late] = store.jobs.claim(FAR.name, 1)
    freed = Mock()
    mine = watching(store, freed)
    for _ in range(ROUNDS):
        mine._round()
        assert store.jobs.claim("mine", 1) == [], "a clock took the job away"
    assert mine.able == 2
    mine._round()
    assert mine.able == 1
    freed.assert_called_once_with()

    [anew] = store.jobs.claim("mine", 1)
    assert (anew.job_id, anew.attempts) == (late.job_id, 2)
    with pytest.raises(LeaseLost):
        finish(store, late)
    finish(store, anew)
    assert store.views.get(view.id).state == "ready"


def test_a_worker_that_gives_signs_of_life_keeps_its_jobs_for_ever(store: SqlStore) -> None:
    enroll(store, "gate")
    mine = watching(store)
    store.workers.beat(FAR, NOW)
    [claim] = store.jobs.claim(FAR.name, 1)
    for number in range(4 * ROUNDS):
        store.workers.beat(FAR, NOW - timedelta(days=number))
        mine._round()
    assert mine.able == 2
    finish(store, claim)


def test_silence_while_nobody_can_write_says_nothing(store: SqlStore, monkeypatch: pytest.MonkeyPatch) -> None:
    store.workers.beat(FAR, NOW)
    mine = watching(store)
    mine._round()
    with monkeypatch.context() as full:
        full.setattr(store.workers, "beat", Mock(side_effect=DiskFull("full")))
        for _ in range(2 * ROUNDS):
            mine._round()
    for _ in range(ROUNDS):
        mine._round()
    assert mine.able == 2, "its rounds are counted from when it could write again"
    mine._round()
    assert mine.able == 1


def test_a_process_of_this_machine_that_is_gone_is_noticed_in_the_next_round(store: SqlStore) -> None:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    enroll(store, "gate")
    dead = replace(this_process("worker", "color"), name="dead", pid=process.pid)
    store.workers.beat(dead, NOW)
    store.jobs.claim(dead.name, 1)
    watching(store)._round()
    assert [worker.name for worker in store.workers.present() if worker.name == "dead"] == []
    assert len(store.jobs.claim("mine", 1)) == 1


def test_machines_made_from_one_image_do_not_take_each_other_s_processes_for_gone(
    store: SqlStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They have one name, and process ids of one and the same namespace: that of every system which is no container."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    (tmp_path / "boot_id").write_text("of the other machine\n")
    with monkeypatch.context() as there:
        there.setattr(attendance, "BOOT", tmp_path / "boot_id")
        other = replace(this_process("worker", "color"), pid=process.pid)
    enroll(store, "gate")
    store.workers.beat(other, NOW)
    [claim] = store.jobs.claim(other.name, 1)
    watching(store)._round()
    assert other.name in [worker.name for worker in store.workers.present()]
    finish(store, claim)


def test_an_image_that_ends_three_workers_is_given_up(store: SqlStore) -> None:
    submitted = enroll(store, "bomb")
    for attempt in (1, 2, 3):
        [claim] = store.jobs.claim(f"worker {attempt}", 1)
        assert claim.attempts == attempt
        assert store.workers.bury([claim.job_id], NOW) == 1
    assert store.jobs.claim("worker", 1) == []
    view = store.views.get(submitted.view.id)
    assert (view.state, view.failure and view.failure[0]) == ("failed", "worker-died")


def test_what_a_service_left_goes_back_at_once_where_another_begins_alone(store: SqlStore) -> None:
    """A container that was killed, and started again: nobody on that machine can see that its process is gone."""
    enroll(store, "gate")
    store.workers.beat(replace(FAR, kind="serve"), NOW)
    store.jobs.claim(FAR.name, 1)
    next_one = watching(store, me=this_process("serve", "color"))
    next_one.start(alone=True)
    assert len(store.jobs.claim("next", 1)) == 1
    next_one.stop()


def test_two_services_with_workers_of_their_own_leave_each_other_their_jobs(store: SqlStore) -> None:
    enroll(store, "gate")
    other = replace(FAR, kind="serve")
    store.workers.beat(other, NOW)
    [claim] = store.jobs.claim(FAR.name, 1)
    mine = watching(store, me=this_process("serve", "color"))
    mine.start(alone=False)
    for _ in range(3 * ROUNDS):
        store.workers.beat(other, NOW)
        mine._round()
    mine.stop()
    finish(store, claim)


def test_workers_with_another_encoder_are_told_from_those_that_describe_what_is_enrolled_here(store: SqlStore) -> None:
    service = watching(store, me=this_process("serve", "color"), works=False)
    service._round()
    assert service.able == 0
    assert "`./revisit worker`" in str(service.nobody)

    for name, encoder in (("a", "lseg"), ("b", "compact"), ("c", "lseg")):
        store.workers.beat(replace(FAR, name=name, encoder=encoder), NOW)
    service._round()
    assert service.able == 0
    assert "describes by color, as this service does, only by compact, lseg:" in str(service.nobody)

    store.workers.beat(replace(FAR, name="d"), NOW)
    store.workers.beat(replace(FAR, name="of a version before", encoder=None), NOW)
    service._round()
    assert (service.able, service.nobody) == (2, None)


def test_a_worker_that_stops_takes_itself_out(store: SqlStore) -> None:
    enroll(store, "gate")
    me = this_process("worker", "color")
    mine = watching(store, me=me)
    mine.start()
    assert [worker.name for worker in store.workers.present()] == [me.name]
    store.jobs.claim(me.name, 1)
    mine.stop()
    assert store.workers.present() == []
    assert len(store.jobs.claim("next", 1)) == 1
