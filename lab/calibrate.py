"""Learn how often an answer is right from labelled queries, and judge that on sets it was not learned from.

``python -m lab.calibrate pairs --root DIR --write FILE``.
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lab import evaluate
from lab.datasets.dataset import Dataset
from lab.datasets.hold_out import hold_out
from lab.evaluation.progress import progress_bar
from lab.evaluation.querying import Answers, query_all
from lab.fitting import Fit, Judgement, fit_isotonic, fit_logistic, judge, leave_one_out, threshold_for_precision
from lab.libraries import FOR_FITTING, require
from lab.metrics.recall import Booleans, Doubles, first_right
from schemas.errors import RevisitError
from worker.method.calibration import Calibration, Logistic, Thresholds

MATCHED_PRECISION = 0.97
"""How often ``matched`` has to be right on the sets that the thresholds are learned from."""

HELD_OUT = 0.3
"""Share of the queries whose places are not enrolled in the second run."""

AMBIGUOUS = 0.4
"""Probability below which an answer is no match, unless ``matched`` begins lower."""

CURVES: Mapping[str, Fit] = {"logistic": fit_logistic, "isotonic": fit_isotonic}
"""Curves by the names that the command line has for them."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What was seen of the first answers to one set's queries, and whether they were right.

    Parameters
    ----------
    features : mapping of name to float64 of shape (queries,)
    right : bool of shape (queries,)
    """

    features: Mapping[str, Doubles]
    right: Booleans

    def columns(self, names: Sequence[str]) -> Doubles:
        """Some features side by side, float64 (queries, names); a feature never seen is 0."""
        nothing = np.zeros(len(self.right))
        return np.stack([self.features.get(name, nothing) for name in names], axis=1)


def evidence(dataset: Dataset, answers: Answers) -> Evidence:
    """The evidence in a run's answers; queries without any answer are left out, since their verdict needs no curve."""
    answered = answers.ranked[:, 0] >= 0
    right = first_right(answers.ranked, dataset.judged()) == 1
    return Evidence({name: values[answered] for name, values in answers.features.items()}, right[answered])


@dataclass(frozen=True, eq=False)
class Learned:
    """A calibration and how it did.

    Parameters
    ----------
    calibration : Calibration
        Learned from all sets.
    by_set : mapping of set to Judgement
        Of a curve learned from all other sets.
    together : Judgement
        All left-out probabilities pooled.
    constant : Judgement
        The same for a curve that knows only how often answers are right elsewhere: what knowing nothing costs.
    matched : pair of float
        Shares of the right and of the wrong left-out answers that come out as matched.
    """

    calibration: Calibration
    by_set: Mapping[str, Judgement]
    together: Judgement
    constant: Judgement
    matched: tuple[float, float]


def learn(sets: Mapping[str, Evidence], names: Sequence[str], source: str, fit: Fit = fit_logistic) -> Learned:
    """Learn a curve over some features and its thresholds.

    Parameters
    ----------
    sets : mapping of name to Evidence
        At least two.
    names : sequence of str
        Features that the curve reads.
    source : str
        For the record.
    fit : function

    Raises
    ------
    ValueError
        Too few sets, or all answers right or all wrong.
    """
    rows = {name: (found.columns(names), found.right) for name, found in sets.items()}
    # Judged, and thresholds chosen, by probabilities that were left out: the curve's own are too sure of themselves.
    left_out, guessed = leave_one_out(rows, fit), leave_one_out(rows, _guess)
    right = np.concatenate([r for _, r in rows.values()])
    together, constant = (np.concatenate(list(found.values())) for found in (left_out, guessed))
    matched = min(threshold_for_precision(together, right, MATCHED_PRECISION), 1.0)
    claimed = together >= matched
    curve = fit(np.concatenate([f for f, _ in rows.values()]), right)
    return Learned(
        calibration=Calibration(tuple(names), curve, Thresholds(matched, min(AMBIGUOUS, matched)), source),
        by_set={name: judge(left_out[name], rows[name][1]) for name in rows},
        together=judge(together, right),
        constant=judge(constant, right),
        matched=(float(claimed[right].mean()), float(claimed[~right].mean())),
    )


def _guess(features: Doubles, right: Booleans) -> Logistic:
    """A curve that knows only how often answers are right."""
    share = float(np.clip(right.mean(), 1e-3, 1 - 1e-3))
    zeros = np.zeros(features.shape[1])
    return Logistic(zeros, zeros + 1, zeros, float(np.log(share / (1 - share))))


def as_markdown(learned: Learned) -> str:
    """How the calibration did on each set that it was not learned from."""
    lines = ["| set | queries | expected calibration error | Brier | log loss |", "| --- | --- | --- | --- | --- |"]
    rows = [*learned.by_set.items(), ("*all, pooled*", learned.together), ("*without evidence*", learned.constant)]
    for name, j in rows:
        lines.append(f"| {name} | {j.queries} | {j.expected_error:.3f} | {j.brier:.3f} | {j.log_loss:.3f} |")
    return "\n".join(lines)


def gather(options: argparse.Namespace, preset: str) -> dict[str, Evidence]:
    """Run a preset on every set, whole and with some places not enrolled; the two count as one set.

    Without the second run a curve would only ever see queries that have an answer, and promise too much of the others.
    """
    gathered: dict[str, Evidence] = {}
    options.preset = [preset]
    with evaluate.services(options) as ([one], _):
        for dataset in evaluate.read(options.dataset, options):
            parts = [dataset]
            if dataset.allowed is None:
                parts.append(hold_out(dataset, HELD_OUT, np.random.default_rng(options.seed)))
            seen = []
            for part in parts:
                with one.open(part) as retriever, progress_bar(part.name) as bar:
                    journals = options.out / "answers"
                    answers = query_all(part, retriever, seed=options.seed, journals=journals, progress=bar)
                seen.append(evidence(part, answers))
            names = sorted({name for s in seen for name in s.features})
            columns = np.concatenate([s.columns(names) for s in seen])
            right = np.concatenate([s.right for s in seen])
            gathered[dataset.name] = Evidence(dict(zip(names, columns.T, strict=True)), right)
    return gathered


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; 0, or 2 when it was used wrongly."""
    parser = argparse.ArgumentParser(prog="calibrate", description=__doc__.splitlines()[0])
    evaluate.add_arguments(parser)
    parser.add_argument("--features", default="lead", help="what the curve reads, comma-separated")
    parser.add_argument("--curve", choices=tuple(CURVES), default="logistic", help="isotonic reads one feature")
    parser.add_argument("--write", type=Path, help="JSON file for the calibration")
    options = parser.parse_args(argv)
    [preset] = options.preset or ["default"]
    try:
        require(FOR_FITTING)
        sets = gather(options, preset)
        source = f"{preset} on {', '.join(sets)}; {HELD_OUT:.0%} of the places held out in a second run"
        learned = learn(sets, options.features.split(","), source, CURVES[options.curve])
    except (RevisitError, ValueError) as refusal:  # ValueError: too little to learn from
        print(refusal, file=sys.stderr)
        return 2
    print(as_markdown(learned))
    limits = learned.calibration.thresholds
    print(f"\nthresholds: matched from {limits.matched:.3f}, ambiguous from {limits.ambiguous:.3f}")
    print("matched are {:.0%} of the right answers and {:.0%} of the wrong ones".format(*learned.matched))
    if options.write:
        options.write.write_text(learned.calibration.to_json() + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
