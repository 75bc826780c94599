"""Calibrations are learned from some sets and judged on others."""

from pathlib import Path

import numpy as np
import pytest

from lab.calibrate import Evidence, as_markdown, evidence, learn
from lab.evaluation.querying import Answer, query_all
from lab.fitting import fit_isotonic, judge
from tests.lab.fakes import FakeRetriever, walk
from worker.method.calibration import Calibration


def drawn(seed: int, n: int = 800) -> Evidence:
    rng = np.random.default_rng(seed)
    score, lead = rng.random(n), rng.random(n)
    right = rng.random(n) < 1 / (1 + np.exp(-(8 * score + 3 * lead - 6)))
    return Evidence({"score": score, "lead": lead}, right)


def test_learned_on_some_sets_and_judged_on_others() -> None:
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
    assert as_markdown(learned).count("\n") == 2 + 3 + 2 - 1


def test_an_isotonic_curve_is_learned_from_one_feature() -> None:
    learned = learn({name: drawn(i) for i, name in enumerate("abc")}, ("score",), "", fit_isotonic)
    assert learned.together.expected_error < 0.05
    assert learned.constant.brier > learned.together.brier + 0.05


def test_matched_is_right_as_often_as_promised() -> None:
    learned = learn({name: drawn(i) for i, name in enumerate("abc")}, ("score", "lead"), "")
    fresh = drawn(11, 5000)
    p = learned.calibration.curve.probability(fresh.columns(("score", "lead")))
    claimed = p >= learned.calibration.thresholds.matched
    assert fresh.right[claimed].mean() > 0.92
    assert claimed.mean() > 0.1
    of_right, of_wrong = learned.matched
    assert of_right == pytest.approx(claimed[fresh.right].mean(), abs=0.1)
    assert of_wrong == pytest.approx(claimed[~fresh.right].mean(), abs=0.05)
    assert of_wrong < 0.1 < of_right


def test_evidence_of_a_run_leaves_out_what_was_not_answered(tmp_path: Path) -> None:
    class Sometimes(FakeRetriever):
        def query(self, image: Path, top: int) -> Answer:
            place = int(image.stem)
            if place % 2:
                return Answer(())
            return Answer((f"view-{place}" if place < 30 else "view-0",), features={"score": place / 40})

    dataset = walk(tmp_path)
    seen = evidence(dataset, query_all(dataset, Sometimes(lambda a, b: 0.0)))
    assert len(seen.right) == 20
    assert seen.right.sum() == 15
    assert seen.columns(("score", "inliers"))[:, 0] == pytest.approx(np.arange(0, 40, 2) / 40)
    assert seen.columns(("inliers",)).tolist() == [[0.0]] * 20
