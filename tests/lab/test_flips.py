"""Random damage to a data folder: nothing is missed, answered wrongly or left unsaid."""

from pathlib import Path

import pytest

from lab.faults.flips import Flips, main, table

TRIALS = 25


@pytest.mark.slow
def test_random_damage_is_found_answered_and_mended(tmp_path: Path) -> None:
    flips = Flips(tmp_path, seed=28)
    trials = [flips.run(number) for number in range(TRIALS)]
    assert not [trial for trial in trials if trial.missed or trial.wrong], table(trials)
    assert {trial.repaired for trial in trials} <= {"nothing to do", "mended", "said what is left"}
    assert sum(trial.found > 0 for trial in trials) > TRIALS / 2


def test_it_goes_on_where_it_stopped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "trials.ndjson"
    assert main(["--flips", "1", "--seed", "3", "--out", str(out)]) == 0
    assert main(["--flips", "2", "--seed", "3", "--out", str(out)]) == 0
    assert len(out.read_text().splitlines()) == 2
    assert capsys.readouterr().out.splitlines()[-1].split()[:2] == ["all", "2"]
