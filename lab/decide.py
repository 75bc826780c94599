"""Measure decisions: what is ``matched``, rightly or not, on maps that know the place, do not, or lie elsewhere.

``python -m lab.decide pairs --root DIR``. docs/research/evaluation.md tells the protocols and the measures.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from lab.datasets.choosing import add_dataset_arguments, add_device, chosen, read, whole
from lab.datasets.dataset import Dataset
from lab.datasets.layout import with_attributes
from lab.datasets.protocols import GUARD, STRETCHES
from lab.evaluate import circumstances
from lab.evaluation import decision_plots
from lab.evaluation.deciding import OTHERS_OF_SMALL_MAPS, SIZES, Decided, Options, as_decisions, decide_all, trials
from lab.evaluation.decision_tables import as_json, as_markdown, rows
from lab.evaluation.in_process import runtime_for_measuring
from lab.evaluation.once import DescribeOnce
from lab.evaluation.progress import progress_bar
from lab.evaluation.service import map_of_its_own
from lab.libraries import FOR_FITTING, FOR_REPORTS, require
from schemas.errors import RevisitError
from schemas.settings import read_settings
from worker.description.presets import Wanted, make_recipe
from worker.runtime import Runtime


def measure(
    wanted: Sequence[Dataset], sets: Sequence[Dataset], runtime: Runtime, preset: str, options: Options
) -> list[Decided]:
    """Decide about the queries of all trials of some sets.

    Parameters
    ----------
    wanted : sequence of Dataset
        Sets whose maps are made.
    sets : sequence of Dataset
        Where queries of other sites come from.
    runtime : Runtime
        Started; with `DescribeOnce` each image is described once for all maps.
    preset : str
    options : Options

    Returns
    -------
    list of Decided
    """
    recipe = make_recipe(runtime.encoder, Wanted(), preset=preset)
    decided = []
    for dataset in map(with_attributes, wanted):
        with progress_bar(dataset.name) as bar:
            for trial in trials(dataset, sets, options):
                with map_of_its_own(runtime, recipe, preset, dataset) as service:
                    found, refused = decide_all(trial, service, seed=options.seed, progress=bar)
                decided += found
                for code, count in refused.items():
                    print(f"{dataset.name}, {trial.protocol}: refused {count} x {code}", file=sys.stderr)
    return decided


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The set, what is measured, and the protocols."""
    add_dataset_arguments(parser)
    add_device(parser)
    parser.add_argument("--out", type=Path, default=Path("runs/decisions"), help="where tables and plots are kept")
    parser.add_argument("--preset", default="default", help="preset to measure")
    parser.add_argument("--sets", default="", help="make maps only of sets whose names begin so, comma-separated")
    parser.add_argument("--apart", default="", help="do not pool sets whose names begin so, comma-separated")
    parser.add_argument("--stretches", type=whole(2), default=STRETCHES, help="of which every other one is enrolled")
    parser.add_argument("--guard", type=whole(0), default=GUARD, help="width of the guard band at a cut, in tolerances")
    parser.add_argument(
        "--sizes",
        type=_sizes,
        default=dict(SIZES),
        help="places of small maps and how many are drawn: SIZExDRAWS, comma-separated, or none (default: "
        + ",".join(f"{size}x{draws}" for size, draws in SIZES.items())
        + ")",
    )
    parser.add_argument("--spread", action="store_true", help="places of small maps from everywhere, not one stretch")
    parser.add_argument(
        "--others", type=whole(0), default=OTHERS_OF_SMALL_MAPS, help="queries of other sites that each small map gets"
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; 0, or 2 when it was used wrongly."""
    parser = argparse.ArgumentParser(prog="python -m lab.decide", description=__doc__.splitlines()[0])
    add_arguments(parser)
    options = parser.parse_args(argv)
    try:
        require((*FOR_FITTING, *FOR_REPORTS))
        sets = read(options.dataset, options)
        wanted = chosen(sets, options.sets)
        options.out.mkdir(parents=True, exist_ok=True)
        with runtime_for_measuring(read_settings(), options.device, make_scheduler=DescribeOnce) as runtime:
            decided = measure(wanted, sets, runtime, options.preset, _options(options))
    except (RevisitError, ValueError) as refusal:  # ValueError: too few places for the protocols
        print(refusal, file=sys.stderr)
        return 2
    _write(decided, options)
    return 0


def _sizes(text: str) -> dict[int, int]:
    """Places of small maps and how many are drawn, as ``1x5,40`` says it."""
    pairs = [] if text in ("", "none") else [size.partition("x") for size in text.split(",")]
    least_one = whole(1)
    return {least_one(size): least_one(draws or "1") for size, _, draws in pairs}


def _options(options: argparse.Namespace) -> Options:
    return Options(
        stretches=options.stretches,
        guard=options.guard,
        sizes=options.sizes,
        others=options.others,
        spread=options.spread,
        seed=options.seed,
    )


def _write(decided: Sequence[Decided], options: argparse.Namespace) -> None:
    """Tables, every decision with its evidence, and plots."""
    apart = tuple(name for name in options.apart.split(",") if name)
    found = rows(decided, options.seed, apart)
    out: Path = options.out
    text = as_markdown(found)
    print(text)
    (out / "decisions.md").write_text(text + "\n")
    summary = as_json(found, circumstances(options.seed))
    (out / "decisions.json").write_text(json.dumps(summary, indent=1, allow_nan=False) + "\n")
    with (out / "decisions.jsonl").open("w") as lines:
        lines.writelines(json.dumps(asdict(one)) + "\n" for one in decided)
    for protocol in dict.fromkeys(one.protocol for one in decided):
        some = as_decisions(
            o for o in decided if o.protocol == protocol and not (apart and o.dataset.startswith(apart))
        )
        for name, plot in decision_plots.PLOTS.items():
            if len(some.at_site):
                (out / f"{protocol.replace(' ', '-')}-{name}.svg").write_bytes(plot(some.at_site))
    print(f"\nall decisions: {out / 'decisions.jsonl'}")


if __name__ == "__main__":
    sys.exit(main())
