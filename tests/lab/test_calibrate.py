"""Calibrations are learned from some sites and judged on others."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from lab.calibrate import ELSEWHERE, Evidence, as_markdown, by_site, learn, main, read, threshold
from lab.evaluation.deciding import Decided
from lab.fitting import fit_isotonic, judge
from worker.method.calibration import Calibration


def drawn(seed: int, n: int = 800) -> Evidence:
    rng = np.random.default_rng(seed)
    score, lead = rng.random(n), rng.random(n)
    right = rng.random(n) < 1 / (1 + np.exp(-(16 * score + 6 * lead - 10)))
    return Evidence({"score": score, "lead": lead}, right, np.full(n, f"set {seed}"))


def test_learned_on_some_sites_and_judged_on_others() -> None:
    learned = learn({name: drawn(i) for i, name in enumerate("abc")}, ("score", "lead"), "drawn numbers")
    assert learned.together.expected_error < 0.05
    assert max(j.expected_error for j in learned.by_set.values()) < 0.08
    # Knowing nothing can be calibrated too, but tells answers apart worse.
    assert learned.constant.brier > learned.together.brier + 0.05
    back = Calibration.from_json(learned.calibration.to_json())
    assert back.features == ("score", "lead")
    assert back.learned_from == "drawn numbers"
    fresh = drawn(9)
    assert judge(back.curve.probability(fresh.columns(back.features)), fresh.right).expected_error < 0.05
    assert list(learned.by_set) == ["set 0", "set 1", "set 2"]
    assert "| set 1 | 800 |" in as_markdown(learned)


def test_an_isotonic_curve_is_learned_from_one_feature() -> None:
    learned = learn({name: drawn(i) for i, name in enumerate("abc")}, ("score",), "", fit_isotonic)
    assert learned.together.expected_error < 0.05
    assert learned.constant.brier > learned.together.brier + 0.05


def test_matched_is_right_as_often_as_wanted() -> None:
    kept = learn({name: drawn(i) for i, name in enumerate("abc")}, ("score", "lead"), "").calibration
    fresh = drawn(11, 5000)
    p = kept.curve.probability(fresh.columns(("score", "lead")))
    for wanted in (0.9, 0.97):
        claimed = p >= kept.threshold(wanted)
        assert fresh.right[claimed].mean() > wanted - 0.02
        assert claimed[fresh.right].mean() == pytest.approx(kept.share(wanted), abs=0.08)
        assert claimed.mean() > 0.1


def test_a_threshold_holds_for_each_set_and_not_only_on_the_whole() -> None:
    p = np.array([0.9] * 1000 + [0.8] * 30)
    right = np.array([True] * 1000 + [True] * 24 + [False] * 6)
    assert threshold(p, right, np.full(1030, "one"), 0.97) <= 0.8
    assert threshold(p, right, np.array(["good"] * 1000 + ["bad"] * 30), 0.97) > 0.8


def test_a_wrong_answer_of_few_raises_no_threshold_and_many_do() -> None:
    p = np.array([0.9] * 1000 + [0.8] * 10)
    right = np.array([True] * 1000 + [True] * 9 + [False])
    sets = np.array(["large"] * 1000 + ["small"] * 10)
    assert threshold(p, right, sets, 0.97) <= 0.8
    tenfold = np.array([0.9] * 1000 + [0.8] * 100), np.append(right[:1000], np.repeat(right[1000:], 10))
    assert threshold(*tenfold, np.array(["large"] * 1000 + ["small"] * 100), 0.97) > 0.8


def decision(dataset: str, kind: str, n: int, right: bool, gap: float) -> list[Decided]:
    found = {"gap": gap, "level": 0.0}
    return [Decided(dataset, "everything", f"{i}.png", kind, right, "matched", 0.5, "b", found) for i in range(n)]  # type: ignore[arg-type]


def test_recorded_decisions_are_read_and_sets_of_one_site_kept_together(tmp_path: Path) -> None:
    some = decision("mill_north query -> database", "known", 50, True, 2.0)
    some += decision("mill_south query -> database", "same-site", 40, False, 0.3)
    some += decision("park query -> database", "known", 50, True, 1.8)
    some += decision("park query -> database", "other-site", 500, False, 0.2)
    path = tmp_path / "decisions.jsonl"
    path.write_text("".join(json.dumps(asdict(one)) + "\n" for one in some))

    sites = by_site(read(path))
    assert {name: len(found.right) for name, found in sites.items()} == {"mill": 90, "park": 50 + ELSEWHERE}
    assert sites["mill"].columns(("gap", "unheard of"))[:, 1].tolist() == [0.0] * 90

    assert main([str(path), "--write", str(tmp_path / "kept.json")]) == 0
    kept = Calibration.from_json((tmp_path / "kept.json").read_text())
    assert kept.curve.probability(np.array([[2.0, 0.0]]))[0] > 0.8
    assert main([str(tmp_path / "absent.jsonl")]) == 2


def test_a_site_may_be_judged_without_being_learned_from() -> None:
    sites, apart = {name: drawn(i) for i, name in enumerate("abc")}, drawn(7)
    wrong = Evidence(apart.features, np.zeros_like(apart.right), apart.sets)  # evidence says nothing there
    plain = learn(sites, ("score", "lead"), "")
    judged = learn(sites, ("score", "lead"), "", judged={"d": wrong})
    assert judged.calibration.curve.as_json() == plain.calibration.curve.as_json()
    assert list(judged.by_set) == ["set 0", "set 1", "set 2", "set 7"]
    assert judged.calibration.threshold(0.9) > plain.calibration.threshold(0.9)
