"""A kill or a power failure while images are being enrolled: nothing acknowledged is lost, and nothing is half-made."""

from collections import Counter
from pathlib import Path

import pytest

from lab.faults.kills import episode
from lab.faults.small_disk import NotMounted

pytestmark = pytest.mark.one_database(
    "the tables that it compares are SQLite's; fleets on PostgreSQL are killed in their stories"
)


@pytest.mark.parametrize(
    ("kind", "kills"), [("serve", 6), ("worker", 4), ("switch", 3), ("migration", 6), ("power", 4)]
)
def test_nothing_acknowledged_is_lost_by_kills_at_any_moment(kind: str, kills: int, tmp_path: Path) -> None:
    """`python -m lab.faults.kills --kills 3000` is the long run."""
    counts: Counter[str] = Counter()

    try:
        episode(tmp_path / "data", kind, 1, kills, counts)
    except NotMounted as error:
        pytest.skip(f"NOT TRIED: the power of a disk needs ext4 and the right to mount it ({error})")

    assert counts["kills"] == kills
    assert counts["views compared"] > 0
    assert counts["views found"] > 0
