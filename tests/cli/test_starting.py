"""The garbage collector rests while a process starts, and looks at what came later from then on."""

import gc

import pytest

from app.cli.starting import collecting_new, collecting_nothing


def test_what_was_there_at_the_start_is_collected_no_more_and_what_comes_later_is() -> None:
    with collecting_nothing():
        assert not gc.isenabled()
        collecting_new()

    assert gc.isenabled()
    assert gc.get_freeze_count() > 1000
    later: list[object] = []
    later.append(later)
    del later
    assert gc.collect() >= 1


def test_a_start_that_fails_leaves_the_collector_as_it_was() -> None:
    with pytest.raises(OSError, match="no space"), collecting_nothing():
        raise OSError("no space")

    assert gc.isenabled()
