"""``revisit demo``: starts a service, enrols places, queries with other images of them, prints the results."""

import argparse
import shlex
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from app.cli import demo_images, images
from app.cli.options import Verbs
from app.cli.output import DONE, FAILED, Failure, progress_bar, say, show, show_json, table, write_file, wrong_use
from app.cli.service import started

if TYPE_CHECKING:
    from revisit_client import Revisit
    from revisit_client.wire import QueryAnswer

    from app.cli.demo_images import Material, QueryRecord

MOST = 0.75
"""Share of known places that must be recognised for the exit code 0."""

SEEN_EVERY = 5
"""Of the first of every five answers the match is also drawn as the service saw it: finer labels take a second."""

REFUSED = (413, 415, 422)
"""Statuses that say something of the image alone."""


def add(verbs: Verbs) -> None:
    """Declare the command."""
    parser = verbs.add_parser(
        "demo",
        help="see it work: enrol places, query with other images of them",
        description="Start a service in a temporary folder, enrol images of places, query with other images of the "
        "same places, and show which were recognised. Without --photos the places are drawn.",
    )
    parser.add_argument("--photos", type=Path, metavar="DIR", help="use the photos of this folder")
    parser.add_argument("--output", type=Path, metavar="DIR", help="folder for images (default: a temporary folder)")
    parser.add_argument("--keep", action="store_true", help="leave the service running until Ctrl-C")
    parser.add_argument("--json", action="store_true", help="answer as JSON, for machines")
    parser.set_defaults(run=run)


@dataclass(frozen=True)
class Result:
    """A query and its answer."""

    query: "QueryRecord"
    answer: "QueryAnswer"

    @property
    def first(self) -> str | None:
        """The place of the best match; None without one, or with the verdict no_match."""
        matches = self.answer.matches
        return matches[0].view.place if matches and self.answer.status != "no_match" else None

    @property
    def is_right(self) -> bool | None:
        """Whether `first` is the right place; None when the right place is not known."""
        return self.first == self.query.place if self.query.known else None


def run(arguments: argparse.Namespace) -> int:
    """Run the demo; returns 1 when fewer than `MOST` of the known places were recognised."""
    from revisit_client import Revisit

    photos = None if arguments.photos is None else _photos(arguments.photos)
    output = arguments.output or Path(tempfile.mkdtemp(prefix="revisit-demo-"))
    output.mkdir(parents=True, exist_ok=True)
    log = output / "service.log"
    with tempfile.TemporaryDirectory(prefix="revisit-demo-data-") as folder, started(Path(folder), log) as service:
        material = _drawn(output) if photos is None else _own(photos, output)  # while the service loads its network
        url = service.url()
        say(f"a service runs at {url} on data in {folder}")
        with Revisit(url) as revisit:
            calls = _enrolled(revisit, material)
            results, answers = _queried(revisit, material, output)
        right = [result.is_right for result in results if result.query.place is not None]
        passed = sum(map(bool, right)) >= MOST * len(right)
        if arguments.json:
            show_json([_facts(result) for result in results])
        else:
            _tell(results, [*calls, *answers], output, keep=arguments.keep)
            unsure = sum(bool(result.is_right) and result.answer.status == "ambiguous" for result in results)
            show(f"\n{sum(map(bool, right))} of {len(right)} known places were recognised: {_confidence_line(unsure)}.")
            if not passed:
                show(f"That is fewer than expected. The service's log: {log}")
        if arguments.keep:
            say(f"the service goes on at {url} (console {url}/, docs {url}/docs); Ctrl-C stops")
            try:
                service.process.wait()
            except KeyboardInterrupt:
                say("")
    return DONE if passed else FAILED


def _photos(folder: Path) -> list[Path]:
    if not folder.is_dir():
        wrong_use(f"{folder}: there is no such folder")
    found = images.find([str(folder)])
    if len(found) < 2:
        wrong_use(f"{folder}: needs at least two images, has {len(found)}")
    return found


def _drawn(output: Path) -> "Material":
    say(f"drawing {len(demo_images.PLACES)} places: streets, parks, corridors")
    with progress_bar(len(demo_images.PLACES) + len(demo_images.UNKNOWN_PLACES), "places drawn") as step:
        return demo_images.drawn(output, step)


def _own(photos: Sequence[Path], output: Path) -> "Material":
    material = demo_images.of_folder(photos, output, lambda _: None)
    say(
        f"{len(material.enrolments)} of your {len(photos)} photos are enrolled, each as a place of its own. Queries\n"
        "are altered copies of some (cropped, turned, darker), which have to find their original, and the photos that\n"
        "were held back: judge by the images whether the place they find is the same."
    )
    return material


def _enrolled(revisit: "Revisit", material: "Material") -> list[str]:
    """Enrol all images; returns the curl call of the first."""
    begun, enrolled = time.monotonic(), []
    with progress_bar(len(material.enrolments), "images enrolled") as step:
        for enrolment in material.enrolments:
            with _left_out(enrolment.path):
                revisit.enroll(enrolment.path, place=enrolment.place)
                enrolled.append(enrolment)
            step(enrolment.place)
    if not enrolled:
        raise Failure("no photo could be enrolled")
    count, seconds = len(enrolled), time.monotonic() - begun
    say(f"enrolled {count} images of {len({one.place for one in enrolled})} places in {seconds:.1f} s")
    first = enrolled[0]
    return [
        f"curl -F image=@{shlex.quote(str(first.path))} -F place={shlex.quote(first.place)} {revisit.url}/enroll"
        f"   # and {count - 1} more"
    ]


@contextmanager
def _left_out(photo: Path) -> Iterator[None]:
    """Say which photo the service refuses, and why, and go on: a folder of one's own has a bad one sooner or later."""
    from revisit_client import RevisitProblem

    try:
        yield
    except RevisitProblem as problem:
        if problem.status not in REFUSED:
            raise
        say(f"left out: {photo}: {problem.detail}")


def _queried(revisit: "Revisit", material: "Material", output: Path) -> tuple[list[Result], list[str]]:
    """Send every query and save the images that explain the answers; returns the results and a curl call."""
    folder = output / "answers"
    folder.mkdir(exist_ok=True)
    results = []
    with progress_bar(len(material.queries), "queries answered") as step:
        for number, query in enumerate(material.queries, start=1):
            answer = None
            with _left_out(query.path):
                answer = revisit.query(query.path, top=3, explain=True)
                results.append(Result(query, answer))
            if answer is not None and answer.matches:
                view = answer.matches[0].view.id
                name = f"{number:02d}-{query.path.stem}"
                write_file(folder / f"{name}-why.png", revisit.explanation(answer.query.id))
                if number % SEEN_EVERY == 1:
                    write_file(folder / f"{name}-labels.png", revisit.segmentation(view, overlay=True, legend=True))
                    write_file(folder / f"{name}-graph.png", revisit.graph(view, legend=True))
            step(query.path.name)
    path = shlex.quote(str(material.queries[0].path))
    call = f"curl -F image=@{path} '{revisit.url}/query'   # and {len(results) - 1} more"
    return results, [call]


def _tell(results: Sequence[Result], calls: Sequence[str], output: Path, *, keep: bool) -> None:
    rows = []
    for result in results:
        first = result.answer.matches[0] if result.answer.matches else None
        mark = {True: "yes", False: "NO", None: "?"}[result.is_right]
        rows.append(
            (
                result.query.path.name,
                result.query.change,
                first.view.place if first else None,
                first.score if first else None,
                result.answer.confidence,
                result.answer.status.replace("_", " "),
                mark,
            )
        )
    heads = ("query", "what is different", "best match", "score", "confidence", "verdict", "right")
    show("\n" + table(heads, rows))
    show(f"\nthe calls it made{'' if keep else ' (the service ends now; with --keep it stays for them)'}:")
    for call in calls:
        show(f"  {call}")
    show(f"\nimages: {output}")
    show("  answers/*-why.png     what decided: query, match and rival, with what agrees")
    show("  answers/*-labels.png  segmentation of the match, of every fifth answer")
    show("  answers/*-graph.png   its context graph")


def _confidence_line(unsure: int) -> str:
    """A sentence on how many of the right answers were `ambiguous`."""
    if not unsure:
        return "the right one came first, and the service was sure"
    return f"the right one came first, in {unsure} cases with the verdict ambiguous"


def _facts(result: Result) -> dict[str, object]:
    matches = result.answer.matches
    return {
        "image": str(result.query.path),
        "change": result.query.change,
        "place": result.query.place,
        "status": result.answer.status,
        "answered": result.first,
        "score": matches[0].score if matches else None,
        "confidence": result.answer.confidence,
        "right": result.is_right,
    }
