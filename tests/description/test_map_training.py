"""Training a vocabulary while the database is away for a moment, and while views are deleted."""

from collections.abc import Iterable
from datetime import datetime
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from schemas.errors import BadImage, Damaged, LeaseLost, NotFound, StorageFailed
from schemas.records import JobProgress, MapClaim
from tests.waiting import until
from worker.description import map_training, vocabularies
from worker.description.map_training import VocabularyTrainer, _Heartbeat
from worker.description.presets import PRESETS

CLAIM = MapClaim("job", "vocabulary", "token", "campus")


class Away:
    """Maps and jobs of a database that is away, and comes back before the end of the job can be stored."""

    failed: str | None = None

    def get(self, name: str) -> Any:
        raise StorageFailed("away")

    def fail_map_job(self, claim: MapClaim, code: str, detail: str, now: datetime) -> None:
        self.failed = code


def test_training_is_put_back_and_not_failed() -> None:
    away: Any = Away()
    trainer = VocabularyTrainer(maps=away, views=away, jobs=away, describers=away, scheduler=away, decode=away.get)
    with pytest.raises(StorageFailed):
        trainer.run(CLAIM, lambda: False)
    assert away.failed is None


def test_a_job_that_was_lost_is_noticed_also_after_the_database_was_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_training, "LOOK_EVERY_S", 0.01)
    answers = iter([StorageFailed("away"), LeaseLost("cancelled")])

    def report(progress: JobProgress) -> None:
        raise next(answers)

    with _Heartbeat(report) as beat:
        until(lambda: beat._lost is not None)
        with pytest.raises(LeaseLost):
            beat.report(JobProgress(1, 2))


def test_views_that_are_deleted_meanwhile_or_damaged_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def image(view_id: str) -> str:
        if view_id == "deleted":
            raise NotFound("view", view_id)
        if view_id == "rotten":
            raise Damaged("its file does not hold what was enrolled")
        return view_id

    def decode(data: bytes) -> Any:
        if str(data) == "huge":  # enrolled under other limits
            raise BadImage("picture-too-large", "too many megapixels")
        return data

    learned: list[str] = []

    def train(fields: Iterable[Any], *_: object) -> Any:
        learned.extend(fields)
        return SimpleNamespace(digest="1" * 64, tensors=b"tensors")

    monkeypatch.setattr("worker.description.vocabularies.train", train)
    ids = ("gate", "deleted", "rotten", "huge", "pond")
    views = SimpleNamespace(image=image, list=lambda *_, **__: ([SimpleNamespace(id=one) for one in ids], None))
    scheduler = SimpleNamespace(
        submit=lambda image, *_, **__: SimpleNamespace(result=lambda: SimpleNamespace(value=image))
    )
    jobs, maps, describers = Mock(), Mock(), Mock()
    maps.get.return_value.description.parameters.seed = 1
    parts: Any = {"maps": maps, "views": views, "jobs": jobs, "describers": describers, "scheduler": scheduler}
    VocabularyTrainer(**parts, decode=decode).run(CLAIM, lambda: False)
    assert sorted(learned) == ["gate", "pond"]
    assert jobs.finish_training.called
    assert not jobs.fail_map_job.called


def test_a_map_without_images_teaches_nothing_and_says_so() -> None:
    recipe = PRESETS["paper"].parameters
    with pytest.raises(ValueError, match="no image to learn from"):
        vocabularies.train([], Mock(), recipe)
