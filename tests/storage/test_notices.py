"""Processes of one PostgreSQL database tell each other of work and of what is settled, and need not."""

import queue
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import sqlalchemy as sa

from schemas.records import ViewAttributes
from schemas.settings import read_settings
from tests.sample_images import photo
from tests.storage.databases import postgres_schema
from tests.waiting import until
from worker.runtime import Runtime, build
from worker.service import settlements
from worker.storage import dialect, notices
from worker.storage.notices import Notices

SOON_S = 30.0
"""On a machine with other work; polling is stretched to two minutes where it matters."""


def until_listening(heard: Notices) -> None:
    until(lambda: heard.listening)


class Heard:
    """Notices of one process, and what it heard."""

    def __init__(self, url: str) -> None:
        self.engine = dialect.make_engine(url)
        self.notices = Notices(self.engine)
        self.got: queue.Queue[str] = queue.Queue()
        self.notices.start(on_work=lambda: self.got.put("work"), on_settled=self.got.put)

    def next(self) -> str:
        return self.got.get(timeout=SOON_S)


@contextmanager
def hearing(url: str) -> Iterator[Heard]:
    one = Heard(url)
    try:
        until_listening(one.notices)
        yield one
    finally:
        one.notices.stop()
        one.engine.dispose()


@pytest.fixture
def url() -> Iterator[str]:
    with postgres_schema() as made:
        yield made


def test_each_hears_of_work_and_of_views_and_those_of_another_schema_do_not(url: str) -> None:
    with postgres_schema() as elsewhere, hearing(url) as a, hearing(url) as b, hearing(elsewhere) as other:
        a.notices.work()
        assert (a.next(), b.next()) == ("work", "work")
        for view in ("v1", "v2"):
            b.notices.settled(view)
        assert {a.next(), a.next()} == {b.next(), b.next()} == {"v1", "v2"}
        other.notices.work()
        assert other.next() == "work"
        b.notices.settled("v3")
        assert (a.next(), b.next()) == ("v3", "v3")


def test_one_that_ends_does_not_wait_until_it_looks_again_and_tells_others_nothing(
    url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(notices, "LISTENS_S", 4 * SOON_S)
    monkeypatch.setattr(notices, "AGAIN_S", SOON_S)  # how long it waits for its threads
    with hearing(url) as other:
        with hearing(url):
            began = time.monotonic()
        assert time.monotonic() - began < SOON_S
        other.notices.work()
        assert other.next() == "work"


def test_many_at_once_are_told_in_few_notices(url: str) -> None:
    views = {f"0195f2a4-7c1e-7b3a-9d52-{number:012}" for number in range(1000)}
    with hearing(url) as a, hearing(url) as b:
        for view in sorted(views):
            a.notices.settled(view)
        assert {b.next() for _ in views} == views


def test_a_connection_that_ends_is_made_anew(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(notices, "AGAIN_S", 0.1)
    with hearing(url) as a, hearing(url) as b:
        with a.engine.connect() as connection:
            ended = connection.execute(
                sa.text("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE query LIKE 'LISTEN%'")
            )
            assert len(list(ended)) >= 2
            connection.rollback()

        def told() -> bool:
            a.notices.work()
            return not b.got.empty()

        until(told)


def started(data: Path, url: str, inline: bool, serving: bool) -> Runtime:
    runtime = build(
        read_settings({}, data=data, database=url, encoder="color", inline_worker=inline, compare=False, threads=1),
        serving=serving,
    )
    runtime.start()
    return runtime


def test_an_enrolment_on_a_node_is_described_at_once_by_a_worker_elsewhere(
    url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(settlements, "LOOK_AGAIN_S", 120.0)
    monkeypatch.setattr("worker.loop.MAP_WORK_EVERY_S", 120.0)
    monkeypatch.setattr("worker.loop.IDLE_S", 120.0)
    node = started(tmp_path, url, False, True)
    worker = started(tmp_path, url, True, False)
    try:
        for runtime in (node, worker):
            assert runtime.store.notices is not None
            until_listening(runtime.store.notices)
        took = []
        for number in range(6):
            began = time.monotonic()
            enrolled = node.services.enroll.enroll(photo(number), "default", ViewAttributes(), patience_s=4 * SOON_S)
            took.append(time.monotonic() - began)
            assert enrolled.view.state == "ready"
    finally:
        worker.stop()
        node.stop()
    assert max(took) < SOON_S
