"""Queues that are full for a moment."""

from typing import Any

import pytest

from schemas.errors import Busy
from worker.service.enroll import Enrolled, EnrollService


def full_at_the_second_image(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the images that are taken from those kept, the second one is refused, once."""
    take, images = EnrollService.take, iter(range(9))

    def full_once(self: EnrollService, *of: Any) -> Enrolled:
        if next(images) == 1:
            raise Busy.queue(64, 0.5, "enrolments")
        return take(self, *of)

    monkeypatch.setattr(EnrollService, "take", full_once)
