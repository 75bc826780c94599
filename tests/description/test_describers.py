"""Which recipes a process can describe by."""

from typing import Any, cast

import pytest

from tests.storage.material import RECIPE
from worker.description.describers import Describers
from worker.encoders.color import ColorEncoder


def test_a_recipe_of_another_encoder_is_told_once_however_often_its_jobs_are_seen(
    caplog: pytest.LogCaptureFixture,
) -> None:
    describers = Describers(ColorEncoder(), cast(Any, None), ())

    assert [describers.has(RECIPE.description) for _ in range(3)] == [False] * 3

    [told] = caplog.messages
    assert told.startswith("images wait that another worker has to describe: this recipe needs the encoder ")
    assert "running is color" in told
