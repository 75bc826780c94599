"""The lock of an image goes with its connection to PostgreSQL; no view that is enrolled meanwhile loses its image."""

import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from threading import Thread
from typing import Any

import pytest
import sqlalchemy as sa

from schemas.records import Filters
from tests.storage.databases import data_folder, postgres_tables
from tests.storage.material import enroll, facts, image
from tests.storage.object_store import ADDRESS, aws, server
from tests.waiting import until
from worker.storage import dialect, enrolment
from worker.storage.store import open_store

GATE = facts(image("gate")).sha256


class Fleet:
    """Two nodes, and somebody who can end connections of theirs."""

    def __init__(self, stack: ExitStack, url: str) -> None:
        self.one, self.other = (
            stack.enter_context(closing(open_store(url, stack.enter_context(data_folder()), 0, ADDRESS)))
            for _ in range(2)
        )
        engine = sa.create_engine(sa.make_url(url).set(drivername="postgresql+psycopg"), isolation_level="AUTOCOMMIT")
        stack.callback(engine.dispose)
        self.connection = stack.enter_context(engine.connect())

    def holders(self) -> list[int]:
        """Backends that hold the lock of the image."""
        locks = "SELECT pid FROM pg_locks WHERE locktype = 'advisory' AND granted AND objsubid = 2 AND objid = :key"
        return list(self.connection.scalars(sa.text(locks), {"key": int(GATE[:2], 16)}))

    def cut(self) -> None:
        """End the connection that holds the lock of the image."""
        until(lambda: len(self.holders()) == 1)
        self.connection.execute(sa.text("SELECT pg_terminate_backend(:pid)"), {"pid": self.holders()[0]})
        until(lambda: self.holders() == [])

    def has_the_image(self) -> bool:
        [view] = self.one.views.list("campus", Filters())[0]
        return self.one.views.image(view.id) == image("gate")


@pytest.fixture
def fleet(monkeypatch: pytest.MonkeyPatch) -> Iterator[Fleet]:
    objects = server()
    objects.empty()
    for name, value in aws(objects.url).items():
        monkeypatch.setenv(name, value)
    with ExitStack() as stack:
        yield Fleet(stack, stack.enter_context(postgres_tables()))


def test_an_enrolment_that_lost_the_lock_before_its_turn_writes_its_image_again(fleet: Fleet) -> None:
    fleet.connection.execute(sa.text(f"SELECT pg_advisory_lock({dialect.WRITERS})"))  # somebody else's turn
    enrolment_ = Thread(target=enroll, args=(fleet.one, "gate"))
    enrolment_.start()
    until(lambda: GATE in {name.rpartition("/")[2] for name in server().names()})
    fleet.cut()
    assert fleet.other._images.discard([GATE]).removed == 1
    fleet.connection.execute(sa.text(f"SELECT pg_advisory_unlock({dialect.WRITERS})"))
    enrolment_.join()
    assert fleet.has_the_image()


def test_who_removes_images_waits_for_an_enrolment_that_lost_the_lock_before_its_commit(
    fleet: Fleet, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So it does where the connection broke in the commit, and nobody knows whether that goes on."""
    keep_pairs = enrolment.keep_pairs
    removal = Thread(target=fleet.other._images.discard, args=([GATE],))

    def late(*arguments: Any) -> None:
        fleet.cut()
        removal.start()
        time.sleep(0.5)
        keep_pairs(*arguments)

    monkeypatch.setattr(enrolment, "keep_pairs", late)
    enroll(fleet.one, "gate")
    removal.join()
    assert fleet.has_the_image()


def test_who_lost_the_lock_removes_nothing_any_more(fleet: Fleet, monkeypatch: pytest.MonkeyPatch) -> None:
    images = fleet.other._images
    owned = images._owned  # type: ignore[attr-defined]

    def enrolled_meanwhile(digests: list[str]) -> set[str]:
        needed: set[str] = owned(digests)
        monkeypatch.setattr(images, "_owned", owned)
        fleet.cut()
        enroll(fleet.one, "gate")
        return needed

    monkeypatch.setattr(images, "_owned", enrolled_meanwhile)
    assert images.discard([GATE]).removed == 0
    assert images.left == {GATE}
    assert fleet.has_the_image()
    assert images.discard(images.left).needed == {GATE}
    assert images.left == set()
