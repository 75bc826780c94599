"""Measure a service on images with ground truth, beside chance, ceiling and baselines.

``python -m lab.evaluate pairs --root DIR`` or ``./revisit evaluate``. docs/evaluation.md tells the protocol.
"""

import argparse
import os
import platform
import resource
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from lab.baselines.baseline import UNREADABLE, Baseline, rank_readable
from lab.baselines.from_files import Descriptors, Ranked, named
from lab.baselines.known import NAMES, PLAIN, Needs, Rivals, rivals
from lab.datasets import utm_names
from lab.datasets.choosing import add_dataset_arguments, add_device, read, whole
from lab.datasets.dataset import Dataset
from lab.evaluation.contender import Contender
from lab.evaluation.gallery import Artist, first_answers, the_papers_figures
from lab.evaluation.html import Example, as_html
from lab.evaluation.measuring import Evaluation, Figures, frame, measure
from lab.evaluation.progress import progress_bar
from lab.evaluation.querying import Answers, Progress, counted, query_all, ranked_by
from lab.evaluation.reranking import Reranking
from lab.evaluation.tables import as_json, as_text, overview
from lab.libraries import FOR_REPORTS, require
from schemas.errors import InvalidParameters, RevisitError
from schemas.settings import read_settings


@dataclass(frozen=True)
class Outcome:
    """What a run on one set leaves: figures, and images for the report."""

    evaluation: Evaluation
    examples: list[Example] = field(default_factory=list)


def run(
    dataset: Dataset,
    contenders: Sequence[Contender],
    baselines: Sequence[Baseline] = (),
    *,
    rerankings: Sequence[Reranking] = (),
    seed: int = 0,
    journals: Path | None = None,
    progress: Progress | None = None,
    examples: int = 3,
) -> Outcome:
    """Measure services and baselines on one set.

    Parameters
    ----------
    dataset : Dataset
    contenders : sequence of Contender
    baselines : sequence of Baseline
    rerankings : sequence of Reranking
        Their answers follow those that they order anew.
    seed : int
        Of the order of enrolment, the intervals and the draw of examples.
    journals : Path or None
        Folder that remembers answers, so that a stopped run can go on.
    progress : Progress or None
    examples : int
        Right and wrong answers of each contender that are drawn for the report; 0 draws none.

    Returns
    -------
    Outcome
    """
    methods = []
    shown: list[Example] = []

    def figures(answers: Answers) -> list[Figures]:
        again = [one.reranked(dataset, answers, progress) for one in rerankings if one.of == answers.method]
        return [each for some in (answers, *again) for each in measure(dataset, some, seed=seed)]

    for contender in contenders:
        with contender.open(dataset) as retriever:
            answers = query_all(dataset, retriever, seed=seed, journals=journals, progress=progress)
            methods += figures(answers)
            if examples:
                artist = contender.artist(retriever) if contender.artist else None
                shown += _images(dataset, answers, artist, examples, seed)
    for baseline in baselines:
        total = len(dataset.database) + len(dataset.queries)
        tick = counted(progress, baseline.name, total)
        distances, unreadable = rank_readable(baseline, dataset.database, dataset.queries, tick)
        answers = ranked_by(distances, dataset, baseline.name)
        methods += figures(replace(answers, refused={UNREADABLE: unreadable} if unreadable else {}))
    found = replace(frame(dataset), methods=tuple(methods), circumstances=circumstances(seed))
    return Outcome(found, shown)


def _images(dataset: Dataset, answers: Answers, artist: Artist | None, count: int, seed: int) -> list[Example]:
    drawn = first_answers(dataset, answers, artist, each=count, seed=seed)
    return drawn + the_papers_figures(dataset, answers, artist, seed)


def circumstances(seed: int) -> dict[str, str]:
    """What has to be known to get the same figures again."""
    packages = ("numpy", "opencv-python-headless", "faiss-cpu", "torch")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
        "threads": os.environ.get("OMP_NUM_THREADS", "all"),
        "cores": str(os.cpu_count()),
        "seed": str(seed),
        # Kilobytes on Linux, bytes on macOS.
        "peak memory": f"{peak / (1024**2 if sys.platform == 'darwin' else 1024):.0f} MB",
    }


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Everything that `main` understands."""
    add_dataset_arguments(parser)
    add_device(parser)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/evaluation"),
        help="where reports and answers are kept (default: runs/evaluation)",
    )
    parser.add_argument(
        "--preset", action="append", help="preset to measure, may be repeated (default: default and paper)"
    )
    parser.add_argument("--baselines", default=",".join(PLAIN), help=f"comma-separated, of {', '.join(NAMES)}; or none")
    parser.add_argument(
        "--ranked",
        action="append",
        default=[],
        metavar="NAME=FILE",
        help="ranked lists of another method (text)",
    )
    parser.add_argument(
        "--descriptors", action="append", default=[], metavar="NAME=FILE", help="descriptors of another method (npz)"
    )
    parser.add_argument("--netvlad", type=Path, help="published weights for the baseline netvlad")
    parser.add_argument("--dinov2", type=Path, help="ONNX file of DINOv2 ViT-S/14 for the baseline anyloc")
    parser.add_argument("--dinov2-block", type=int, help="block whose tokens anyloc reads, of 0..11 (default: 10)")
    parser.add_argument("--aliked-lightglue", type=Path, metavar="FOLDER", help="weights that --rerank needs")
    parser.add_argument(
        "--rerank",
        action="append",
        default=[],
        metavar="METHOD",
        help="order the first answers of a method anew by ALIKED and LightGlue: a preset, or a name as in the tables",
    )
    parser.add_argument(
        "--aliked-side",
        type=whole(32),
        default=640,
        metavar="PIXELS",
        help="longer side of the images that ALIKED sees (default: 640)",
    )
    parser.add_argument(
        "--rerank-first", type=int, default=10, metavar="N", help="first answers that --rerank orders (default: 10)"
    )
    parser.add_argument(
        "--export",
        type=Path,
        metavar="FOLDER",
        help="copy the set for other programs, with positions in the names of its files; measure nothing",
    )
    parser.add_argument(
        "--url",
        help="measure the service that runs at this address, in a map of its own; where it has keys, by that in "
        "REVISIT_KEY, of the scope admin",
    )
    parser.add_argument("--no-service", action="store_true", help="measure baselines only")
    parser.add_argument(
        "--truth-only", action="store_true", help="print sizes, chance and ceiling of the ground truth only"
    )
    parser.add_argument(
        "--examples", type=whole(0), default=3, help="right and wrong answers of each method in the report (default: 3)"
    )


def main(argv: Sequence[str] | None = None, connect: Callable[[str, str], Contender] | None = None) -> int:
    """Run the command.

    Parameters
    ----------
    argv : sequence of str or None
    connect : function or None
        From a URL and a preset to the service that runs there; given by `app`, which knows HTTP.

    Returns
    -------
    int
        0, or 2 when it was used wrongly, or a folder or weights are not as they must be.
    """
    parser = argparse.ArgumentParser(prog="revisit evaluate", description=__doc__.splitlines()[0])
    add_arguments(parser)
    options = parser.parse_args(argv)
    try:
        return evaluate(options, connect)
    except RevisitError as refusal:
        print(refusal.detail, file=sys.stderr)
        return 2


def evaluate(options: argparse.Namespace, connect: Callable[[str, str], Contender] | None = None) -> int:
    """Run the command from parsed arguments; raises RevisitError."""
    datasets = read(options.dataset, options)
    if options.export is not None:
        return export(datasets, options.export)
    if options.truth_only:
        print("\n\n".join(as_text(frame(dataset)) for dataset in datasets))
        return 0
    require(FOR_REPORTS)
    outcomes = []
    with services(options, connect) as (contenders, needs):
        others = others_of(options, needs)
        options.out.mkdir(parents=True, exist_ok=True)
        for dataset in datasets:
            with progress_bar(dataset.name) as progress:
                outcome = run(
                    dataset,
                    contenders,
                    others.baselines,
                    rerankings=others.rerankings,
                    seed=options.seed,
                    journals=options.out / "answers",
                    progress=progress,
                    examples=options.examples,
                )
            print(as_text(outcome.evaluation) + "\n", flush=True)
            outcomes.append(outcome)
    evaluations = [o.evaluation for o in outcomes]
    (options.out / "evaluation.json").write_text(as_json(evaluations))
    images = {o.evaluation.dataset: o.examples for o in outcomes}
    for name, text in (
        ("evaluation.md", overview(evaluations) + "\n"),
        ("report.html", as_html(evaluations, images, f"revisit on {options.root.name}")),
    ):
        (options.out / name).write_text(text, "utf-8", "backslashreplace")  # the name of the root may be no UTF-8
    print(f"report: {options.out / 'report.html'}")
    return 0


def export(datasets: Sequence[Dataset], target: Path) -> int:
    """Copy a set for other programs; raises InvalidParameters."""
    if len(datasets) > 1:
        raise InvalidParameters.of("export", f"one set at a time; there are {len(datasets)}: name one by --root")
    utm_names.export(datasets[0], target)
    print(f"{target}: {len(datasets[0].database)} images in database, {len(datasets[0].queries)} in queries")
    return 0


def others_of(options: argparse.Namespace, needs: Needs) -> Rivals:
    """What the service is compared with: baselines, what was left in files, and first answers ordered anew."""
    names = [] if options.baselines in ("", "none") else options.baselines.split(",")
    made = rivals(names, needs, options.seed)
    files: list[Ranked | Descriptors] = [*named(options.ranked, Ranked), *named(options.descriptors, Descriptors)]
    if lost := [str(one.path) for one in files if not one.path.is_file()]:
        raise InvalidParameters.of("file", f"there is no {', '.join(lost)}")
    everything = (*made.baselines, *files)
    there = [one.name for one in everything] + ([] if options.no_service else presets(options))
    if twice := [name for name, count in Counter(there).items() if count > 1]:
        raise InvalidParameters.of("methods", f"two are called {', '.join(twice)}: give one another name, NAME=FILE")
    if not there:
        raise InvalidParameters.of("methods", "there are none to measure; --truth-only looks at the set alone")
    if not options.rerank:
        return replace(made, baselines=everything)
    if unknown := [name for name in options.rerank if name not in there]:
        raise InvalidParameters.of("rerank", f"{', '.join(unknown)} is not measured here; there are {', '.join(there)}")
    if options.aliked_lightglue is None:
        raise InvalidParameters.of(
            "rerank", "needs the weights of ALIKED and LightGlue: --aliked-lightglue FOLDER (docs/evaluation.md)"
        )
    if options.rerank_first < 1:
        raise InvalidParameters.of("rerank-first", "is the number of answers that are ordered, 1 or more")
    # Late: it brings torch, and a package that only this needs.
    from lab.baselines.aliked_lightglue import AlikedLightGlue

    verifier = AlikedLightGlue(options.aliked_lightglue, options.device, options.aliked_side)
    again = tuple(Reranking(verifier, name, options.rerank_first) for name in options.rerank)
    return Rivals(everything, (*made.rerankings, *again))


def presets(options: argparse.Namespace) -> list[str]:
    """Names of the presets that are measured."""
    return options.preset or ["default", "paper"]


@contextmanager
def services(
    options: argparse.Namespace, connect: Callable[[str, str], Contender] | None = None
) -> Iterator[tuple[list[Contender], Needs]]:
    """The services to measure, and what baselines can use of them: one runtime, started, with a map for each preset."""
    needs = Needs(
        netvlad=options.netvlad, dinov2=options.dinov2, dinov2_block=options.dinov2_block, device=options.device
    )
    if options.no_service:
        yield [], needs
    elif options.url:
        if connect is None:
            raise InvalidParameters.of("url", "only `revisit evaluate` can measure a service by URL")
        yield [connect(options.url, preset) for preset in presets(options)], needs
    else:
        # Late: a runtime brings torch, the database and the index, which baselines do without.
        from lab.evaluation.in_process import contender, runtime_for_measuring

        with runtime_for_measuring(read_settings(), options.device) as runtime:
            recipe = runtime.default_recipe.description
            inside = replace(
                needs,
                encoder=runtime.encoder,
                labels=recipe.labels,
                dynamic=recipe.dynamic,
                decode=lambda path: runtime.decode(path.read_bytes()),
            )
            yield [contender(runtime, preset) for preset in presets(options)], inside


if __name__ == "__main__":
    sys.exit(main())
