from pathlib import Path

from lab.benchmarks import keys


def test_two_services_are_called_in_turns_with_and_without_keys(tmp_path: Path) -> None:
    costs = keys.measure(tmp_path, keys=2, repeats=3)

    assert [cost.call for cost in costs] == list(keys.CALLS)
    assert all(0 < cost.without < 5000 and 0 < cost.checked < 5000 for cost in costs)
    assert {path.name for path in tmp_path.iterdir()} == {"plain", "keyed"}
