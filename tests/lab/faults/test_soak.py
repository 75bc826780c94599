"""Nothing grows while the number of views stays the same; and what grows is noticed."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from lab.faults.live_service import LiveService
from lab.faults.soak import BOUNDS, SETTINGS, judge, soak


@pytest.fixture
def served(tmp_path: Path) -> Iterator[LiveService]:
    served = LiveService(tmp_path, Counter(), settings=SETTINGS)
    yield served
    served.close()


@pytest.mark.slow
def test_nothing_grows_under_a_load_of_sound_and_unsound_calls(served: LiveService) -> None:
    """`python -m lab.faults.soak --minutes 60` is the long run."""
    counts: Counter[str] = Counter()

    lines, wrong = soak(served, 0.75, 1, counts)

    assert not wrong, "\n".join([*wrong, *lines])
    assert min(counts["turn over"], counts["refused"], counts["break off"]) > 20, counts


@pytest.mark.parametrize("leaks", list(BOUNDS))
def test_what_leaks_is_named(leaks: str) -> None:
    seconds = [float(second) for second in range(100)]
    steady = {"memory, MB": 150.0, "open files": 30.0, "threads": 20.0, "temporary files": 0.0}
    samples = [{**steady, "write-ahead log, MB": 4.0 * (second % 3)} for second in seconds]

    assert judge(seconds, samples)[1] == []
    for second, one in zip(seconds, samples, strict=True):
        one[leaks] += 0.2 * second
    [grown] = judge(seconds, samples)[1]
    assert leaks in grown
