"""Many clients at once: each finds its own views at once, and no answer holds anything of another's."""

from collections import Counter
from pathlib import Path

from lab.faults.clients import churn
from lab.faults.live_service import LiveService


def test_no_answer_mixes_two_clients(tmp_path: Path) -> None:
    """`python -m lab.faults.clients --clients 16 --minutes 30` is the long run."""
    counts: Counter[str] = Counter()
    served = LiveService(tmp_path, Counter())
    try:
        wrong = churn(served, 8, 8.0, 1, counts)
    finally:
        served.close()

    assert not wrong, "\n".join(wrong)
    assert counts["enrolments found by the next query"] > 0
    assert counts["deletions not found by the next query"] > 0
