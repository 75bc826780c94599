"""Learn how often a first place is right from recorded decisions, and judge that on sites it was not learned from.

``python -m lab.calibrate runs/decisions/decisions.jsonl --write FILE``; `lab.decide` records the decisions.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lab.datasets.protocols import site_named
from lab.evaluation.deciding import Decided
from lab.fitting import Fit, Judgement, fit_isotonic, fit_logistic, judge, leave_one_out
from lab.libraries import FOR_FITTING, require
from schemas.description import Booleans, Doubles
from schemas.errors import RevisitError
from worker.method.calibration import Calibration, Logistic

PRECISIONS = (0.5, 0.9, 0.95, 0.97, 0.98, 0.99)
"""Wanted shares of right answers among the matched ones for which thresholds are looked for."""

TOGETHER = 20
"""Answers as which all sets together count beside the matched ones of a single set: one wrong of ten is chance."""

SLACK = 0.05
"""By how much the precision of a single set, drawn so towards that of all, may fall short."""

AMBIGUOUS = 0.4
"""Probability below which an answer is no match, unless ``matched`` begins lower."""

AT_SITE, ELSEWHERE = 360, 120
"""Queries at the site and of other sites that each set gives to learn from at most: a set with more protocols than
others would decide for all, and queries of other sites are easy and many."""

Names = npt.NDArray[np.str_]

GRID = np.round(np.arange(AMBIGUOUS, 1.0, 0.0025), 4)
"""Thresholds that are tried."""

CURVES: Mapping[str, Fit] = {"logistic": fit_logistic, "isotonic": fit_isotonic}
"""Curves by the names that the command line has for them."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What was seen of the first places of some queries, and whether they were right.

    Parameters
    ----------
    features : mapping of name to float64 of shape (queries,)
    right : bool of shape (queries,)
    sets : str of shape (queries,)
        Name of the set that each query belongs to.
    """

    features: Mapping[str, Doubles]
    right: Booleans
    sets: Names

    def columns(self, names: Sequence[str]) -> Doubles:
        """Some features side by side, float64 (queries, names); a feature never seen is 0."""
        nothing = np.zeros(len(self.right))
        return np.stack([self.features.get(name, nothing) for name in names], axis=1)


def read(path: Path) -> list[Decided]:
    """Recorded decisions."""
    return [Decided(**json.loads(line)) for line in path.read_text().splitlines()]


def by_site(decided: Sequence[Decided]) -> dict[str, Evidence]:
    """Evidence by site, since sets of one site share places; queries without any answer are left out."""
    found: dict[tuple[str, int], list[Decided]] = {}
    for one in decided:
        if one.features:
            found.setdefault((one.dataset, ELSEWHERE if one.kind == "other-site" else AT_SITE), []).append(one)
    rng = np.random.default_rng(0)
    kept: dict[str, list[Decided]] = {}
    for (name, most), some in found.items():
        chosen = np.sort(rng.permutation(len(some))[:most])
        kept.setdefault(site_named(name), []).extend(some[i] for i in chosen)
    return {site: _evidence(some) for site, some in kept.items()}


def _evidence(some: Sequence[Decided]) -> Evidence:
    names = sorted({name for one in some for name in one.features})
    features = {name: np.array([one.features.get(name, 0.0) for one in some]) for name in names}
    return Evidence(features, np.array([one.right for one in some]), np.array([one.dataset for one in some]))


@dataclass(frozen=True, eq=False)
class Learned:
    """A calibration and how it did.

    Parameters
    ----------
    calibration : Calibration
        Learned from all sites.
    by_set : mapping of set to Judgement
        Of a curve learned from all other sites.
    together : Judgement
        All left-out probabilities pooled.
    constant : Judgement
        The same for a curve that knows only how often answers are right elsewhere: what knowing nothing costs.
    """

    calibration: Calibration
    by_set: Mapping[str, Judgement]
    together: Judgement
    constant: Judgement


def learn(
    sites: Mapping[str, Evidence],
    names: Sequence[str],
    source: str,
    fit: Fit = fit_logistic,
    judged: Mapping[str, Evidence] | None = None,
) -> Learned:
    """Learn a curve over some features and its thresholds.

    Parameters
    ----------
    sites : mapping of name to Evidence
        At least two.
    names : sequence of str
        Features that the curve reads.
    source : str
        For the record.
    fit : function
    judged : mapping of name to Evidence, optional
        Sites that are not learned from, such as those whose terms forbid it; the thresholds must hold for them too.

    Raises
    ------
    ValueError
        Too few sites, or all answers right or all wrong.
    """
    rows = {name: (found.columns(names), found.right) for name, found in sites.items()}
    # Judged, and thresholds chosen, by probabilities that were left out: the curve's own are too sure of themselves.
    left_out, guessed = leave_one_out(rows, fit), leave_one_out(rows, _guess)
    everything = [np.concatenate(part) for part in zip(*rows.values(), strict=True)]
    curve, guess = fit(*everything), _guess(*everything)
    for name, found in (judged or {}).items():
        columns = found.columns(names)
        left_out[name], guessed[name] = curve.probability(columns), guess.probability(columns)
    whole = {**sites, **(judged or {})}
    right = np.concatenate([found.right for found in whole.values()])
    sets = np.concatenate([found.sets for found in whole.values()])
    together, constant = (np.concatenate(list(found.values())) for found in (left_out, guessed))
    thresholds = np.maximum.accumulate([threshold(together, right, sets, wanted) for wanted in PRECISIONS])
    shares = np.array([float((together[right] >= limit).mean()) for limit in thresholds])
    return Learned(
        calibration=Calibration(tuple(names), curve, np.array(PRECISIONS), thresholds, shares, AMBIGUOUS, source),
        by_set={name: judge(together[sets == name], right[sets == name]) for name in dict.fromkeys(sets.tolist())},
        together=judge(together, right),
        constant=judge(constant, right),
    )


def threshold(probability: Doubles, right: Booleans, sets: Names, precision: float) -> float:
    """The lowest threshold whose matched answers keep a precision, all together and, nearly, in each set.

    Parameters
    ----------
    probability : float64 of shape (n,)
    right : bool of shape (n,)
    sets : str of shape (n,)
    precision : float
        0..1.

    Returns
    -------
    float
        The highest one of `GRID` when there is none.
    """
    return float(next((limit for limit in GRID if _keeps(probability >= limit, right, sets, precision)), GRID[-1]))


def _keeps(claimed: Booleans, right: Booleans, sets: Names, precision: float) -> bool:
    if not claimed.any() or (pooled := right[claimed].mean()) < precision:
        return False
    alone = (right[claimed & (sets == name)] for name in np.unique(sets))
    drawn = ((some.sum() + TOGETHER * pooled) / (len(some) + TOGETHER) for some in alone)
    return all(share >= precision - SLACK for share in drawn)


def _guess(features: Doubles, right: Booleans) -> Logistic:
    """A curve that knows only how often answers are right."""
    share = float(np.clip(right.mean(), 1e-3, 1 - 1e-3))
    zeros = np.zeros(features.shape[1])
    return Logistic(zeros, zeros + 1, zeros, float(np.log(share / (1 - share))))


def as_markdown(learned: Learned) -> str:
    """How the calibration did on each set that it was not learned from, and its thresholds."""
    lines = ["| set | queries | expected calibration error | Brier | log loss |", "| --- | --- | --- | --- | --- |"]
    rows = [*learned.by_set.items(), ("*all, pooled*", learned.together), ("*without evidence*", learned.constant)]
    for name, j in rows:
        lines.append(f"| {name} | {j.queries} | {j.expected_error:.3f} | {j.brier:.3f} | {j.log_loss:.3f} |")
    kept = learned.calibration
    lines += ["", "| `precision` | `matched` from | of right answers `matched` |", "| --- | --- | --- |"]
    for wanted, limit, share in zip(kept.precisions, kept.thresholds, kept.shares, strict=True):
        lines.append(f"| {wanted:.2f} | {limit:.4f} | {share:.0%} |")
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; 0, or 2 when it was used wrongly."""
    parser = argparse.ArgumentParser(prog="python -m lab.calibrate", description=__doc__.splitlines()[0])
    parser.add_argument("decisions", type=Path, nargs="+", help="decisions.jsonl, as lab.decide writes them")
    parser.add_argument("--features", default="gap,level", help="what the curve reads, comma-separated")
    parser.add_argument("--curve", choices=tuple(CURVES), default="logistic", help="isotonic reads one feature")
    parser.add_argument("--apart", default="", help="sites that are judged and not learned from, comma-separated")
    parser.add_argument("--write", type=Path, help="JSON file for the calibration")
    options = parser.parse_args(argv)
    try:
        require(FOR_FITTING)
        decided = [one for path in options.decisions for one in read(path)]
        whole, apart = by_site(decided), options.apart.split(",")
        judged = {name: found for name, found in whole.items() if name in apart}
        sites = {name: found for name, found in whole.items() if name not in apart}
        sets = dict.fromkeys(name for found in sites.values() for name in found.sets.tolist())
        source = f"decisions on {', '.join(sets)}"
        learned = learn(sites, options.features.split(","), source, CURVES[options.curve], judged)
    except (OSError, RevisitError, ValueError) as refusal:  # ValueError: too little to learn from
        print(refusal, file=sys.stderr)
        return 2
    print(as_markdown(learned))
    if options.write:
        options.write.write_text(learned.calibration.to_json() + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
