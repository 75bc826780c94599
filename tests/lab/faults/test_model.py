"""The service and a plain model of it agree; and a model that is told a lie notices it."""

from collections import Counter
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from lab.faults import model
from lab.faults.comparing import compare_all, compare_tables
from lab.faults.damaging import Damaging, has_own_disk
from lab.faults.ledger import Violation
from lab.faults.live_service import LiveService
from lab.faults.run import Tally
from lab.faults.small_disk import NotMounted, small_disk
from worker.storage.tables import CELLS

SEEDS = (1, 2)
OPERATIONS = 200


@pytest.mark.parametrize("seed", SEEDS)
def test_a_service_and_a_plain_model_of_it_agree(seed: int, tmp_path: Path) -> None:
    """`python -m lab.faults.model --operations 200000` is the long run."""
    model.live(tmp_path, seed, OPERATIONS, Counter())


def test_they_agree_through_damage_and_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    often = {"damage_description": 12.0, "damage_attributes": 3.0, "damage_image": 3.0, "fill_disk": 3.0}
    monkeypatch.setattr(model, "WEIGHTS", model.WEIGHTS | often)
    counts: Counter[str] = Counter()
    with ExitStack() as held:
        try:
            held.enter_context(small_disk(tmp_path, model.DISK_MB))
        except NotMounted as error:
            print(f"NOT TRIED: a full disk needs the right to mount one ({error})")
        model.live(tmp_path, 10, 100, counts)
        done = "damage found by a query", "damage mended by doctor", "damage_attributes", "damage_image"
        assert all(counts[name] for name in done), counts
        assert counts["fill_disk"] or not has_own_disk(tmp_path)


def test_damage_that_doctor_does_not_name_is_a_violation(tmp_path: Path) -> None:
    served = LiveService(tmp_path, Counter())
    try:
        doing = Damaging(served, np.random.default_rng(0), Counter())
        doing.enroll()
        known = doing.some_view()
        assert known is not None
        with pytest.raises(Violation, match=f"doctor says nothing of view {known.id}"):
            doing._repair(CELLS, known, doing._body(CELLS, known) or b"")
    finally:
        served.close()


def test_what_is_lost_invented_or_changed_behind_the_services_back_is_noticed(tmp_path: Path) -> None:
    served = LiveService(tmp_path, Counter())
    try:
        doing = Damaging(served, np.random.default_rng(0), Counter())
        for _ in range(4):
            doing.enroll()
        compare_all(served, doing.maps)
        known = next(view for of in doing.maps.values() for view in of.views.values())

        [file] = (tmp_path / "pictures").rglob(f"{known.digest}*")
        kept = file.read_bytes()
        file.write_bytes(kept[:-1] + b"x")
        with pytest.raises(Violation, match="is damaged"):
            compare_all(served, doing.maps)
        file.write_bytes(kept)
        (file.parent / ("0" * 64 + ".png")).write_bytes(b"")
        with pytest.raises(Violation, match="without a view"):
            compare_all(served, doing.maps)
        (file.parent / ("0" * 64 + ".png")).unlink()
        compare_all(served, doing.maps)
        compare_tables(tmp_path / "revisit.db")

        served.call("DELETE", f"/views/{known.id}")
        with pytest.raises(Violation):
            compare_all(served, doing.maps)
    finally:
        served.close()


def test_a_violation_is_told_with_what_replays_it_and_fails_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def wrong(self: Damaging) -> None:
        raise Violation("two and two are five")

    monkeypatch.setattr(Damaging, "enroll", wrong)
    checkpoint = tmp_path / "run.json"
    options = ["--operations", "40", "--seed", "3", "--checkpoint", str(checkpoint), "--folder", str(tmp_path)]

    assert model.main(options) == 1

    told = capsys.readouterr().out
    assert "two and two are five" in told
    assert "--episode-seed 300000 --operations" in told
    kept = Tally.resume(checkpoint, "model", 3)
    assert (kept.done, len(kept.violations)) == (1, 1)
    with pytest.raises(SystemExit, match="name another file"):
        Tally.resume(checkpoint, "model", 4)
