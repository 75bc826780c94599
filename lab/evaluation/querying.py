"""Enrol a data set, make its queries one by one, and remember every answer so that a run can go on where it stopped."""

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from lab.datasets.dataset import Dataset, digest
from lab.metrics.recall import Indices
from schemas.description import Booleans, Doubles, Floats
from schemas.errors import RevisitError, SetupError
from schemas.records import Position
from worker.method.calibration import Verdict

PATIENCE_S = 600.0
"""How long the description of one image may take."""

IMAGE_FAULTS = frozenset(
    {
        "body-too-large",  # over HTTP
        "conflict",  # the same bytes again, at another position
        "no-picture",  # over HTTP: an empty file
        "not-a-picture",
        "nothing-static",
        "picture-too-large",
        "picture-too-small",
        "undecodable-picture",
    }
)
"""Codes of refusals that are an image's own fault: they count as no answer."""


@dataclass(frozen=True)
class Answer:
    """What a service says to one query.

    Parameters
    ----------
    views : tuple of str
        Ids that `Retriever.enroll` gave, best first.
    before : tuple of str or None
        The same before re-ranking, by the histograms alone; None where that is not known.
    scores : tuple of float
        One for each of `views`.
    confidence : float
        Probability that the first is right, 0..1.
    status : str
        ``matched``, ``ambiguous`` or ``no_match``.
    timing_ms : mapping of stage to milliseconds
    features : mapping of str to float
        What a calibration may read of the first answer (`worker.method.features.features`); empty where not known.
    """

    views: tuple[str, ...]
    before: tuple[str, ...] | None = None
    scores: tuple[float, ...] = ()
    confidence: float = 0.0
    status: Verdict = "no_match"
    timing_ms: Mapping[str, float] = field(default_factory=dict)
    features: Mapping[str, float] = field(default_factory=dict)


class Retriever(Protocol):
    """A service to be measured, in this process or behind a URL. It starts with nothing enrolled."""

    @property
    def name(self) -> str:
        """As it stands in tables: its preset."""
        ...

    @property
    def recipe(self) -> str:
        """Names all that decides its answers; a run is only resumed with the same one."""
        ...

    def enroll(self, image: Path, position: Position) -> str:
        """Add an image; searchable when this returns. The same bytes may give the id they had before."""
        ...

    def query(self, image: Path, top: int) -> Answer:
        """The views that look most like an image, at most `top`."""
        ...


class Progress(Protocol):
    """Is called with how far a run is."""

    def __call__(self, what: str, done: int, total: int) -> None:
        """`done` of `total` images have been dealt with."""
        ...


@dataclass(frozen=True, eq=False)
class Answers:
    """All answers of one method to the queries of one set.

    Parameters
    ----------
    method : str
    ranked : int64 of shape (queries, depth)
        Database indices, best first; -1 where there was no further answer.
    confidence : float64 of shape (queries,) or None
        That the first answer is right: a probability when `calibrated`, otherwise any score that grows with it. None
        where it is not known.
    before : int64 of shape (queries, depth) or None
        As `ranked`, before re-ranking.
    claimed : bool of shape (queries,) or None
        Whether the status was ``matched``.
    calibrated : bool
    timing_ms : mapping of stage to float64 of shape (queries that reported it,)
    features : mapping of str to float64 of shape (queries,)
        Evidence of the first answers; 0 where there was none.
    refused : mapping of error code to count
        Images that could not be enrolled or queried.
    """

    method: str
    ranked: Indices
    confidence: Doubles | None
    before: Indices | None = None
    claimed: Booleans | None = None
    calibrated: bool = False
    timing_ms: Mapping[str, Doubles] = field(default_factory=dict)
    features: Mapping[str, Doubles] = field(default_factory=dict)
    refused: Mapping[str, int] = field(default_factory=dict)


def query_all(
    dataset: Dataset,
    retriever: Retriever,
    *,
    seed: int = 0,
    depth: int = 20,
    journals: Path | None = None,
    progress: Progress | None = None,
) -> Answers:
    """Enrol the database and make every query.

    Parameters
    ----------
    dataset : Dataset
    retriever : Retriever
        Empty.
    seed : int
        Orders the enrolment. Ties go to what was enrolled first; in the order of the files, that would favour a
        walk over itself.
    depth : int
        Answers wanted of each query.
    journals : Path or None
        Folder that remembers answers, a file for each (set, recipe, seed, depth): a run that was stopped goes on
        after its last answer.
    progress : Progress or None

    Returns
    -------
    Answers

    Notes
    -----
    In online loop closure the database grows as the drive goes on: before each query, what it may know is enrolled.
    """
    tell = progress or _silent
    wanted, depth = depth, depth + _most_ignored(dataset)
    journal = _Journal(journals, dataset, retriever, seed, depth)
    total = len(dataset.database)
    if dataset.allowed is None:
        allowed = np.full(len(dataset.queries), total, np.int64)
        order = np.random.default_rng(seed).permutation(total)
    else:
        allowed, order = dataset.allowed, np.arange(total)
    images: dict[str, list[int]] = {}
    enrolled = 0
    for done, query in enumerate(np.argsort(allowed, kind="stable").tolist(), start=1):
        if query not in journal.answers:
            while enrolled < allowed[query]:
                image = int(order[enrolled])
                try:
                    view = retriever.enroll(dataset.database[image], position_of(dataset, image))
                    images.setdefault(view, []).append(image)
                except RevisitError as refusal:
                    journal.refused("image", image, refusal)
                enrolled += 1
                tell("enrolling", enrolled, total)
            try:
                answer = retriever.query(dataset.queries[query], depth)
            except RevisitError as refusal:
                journal.refused("query", query, refusal)
                answer = Answer(())
            journal.keep(query, answer, images)
        tell("querying", done, len(dataset.queries))
    return _without_ignored(journal.results(depth), dataset, wanted)


def image_fault(refusal: RevisitError) -> str:
    """The code of an image that was refused; anything else, such as a service that is too busy, ends the run."""
    if refusal.code not in IMAGE_FAULTS:
        raise refusal
    return refusal.code


class _Journal:
    """Answers and refusals so far, in memory and, if there is a folder, in a file of JSON lines."""

    def __init__(self, folder: Path | None, dataset: Dataset, retriever: Retriever, seed: int, depth: int) -> None:
        self.method, self.count = retriever.name, len(dataset.queries)
        self.answers: dict[int, Answer] = {}
        self.codes: dict[tuple[str, int], str] = {}
        self.path: Path | None = None
        if folder is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / f"{fingerprint(dataset, retriever.recipe, seed, depth)}.jsonl"
        if not self.path.is_file():
            return
        lines = self.path.read_bytes().split(b"\n")
        for line in lines[:-1]:  # what follows the last line break was cut off while being written
            data = json.loads(line)
            if "refused" in data:
                self.codes[data["what"], data["number"]] = data["refused"]
                continue
            query = data.pop("query")
            views, before = (None if v is None else tuple(v) for v in (data.pop("views"), data.pop("before")))
            scores = tuple(data.pop("scores"))
            self.answers[query] = Answer(views or (), before, scores, **data)
        if lines[-1]:
            self.path.write_bytes(b"\n".join(lines[:-1]) + b"\n" if len(lines) > 1 else b"")

    def refused(self, what: str, number: int, refusal: RevisitError) -> None:
        """Remember once that an image was refused: a run that goes on enrols what the first one did."""
        code = image_fault(refusal)
        if (what, number) not in self.codes:
            self.codes[what, number] = code
            self._write({"refused": code, "what": what, "number": number})

    def keep(self, query: int, answer: Answer, images: Mapping[str, list[int]]) -> None:
        """Remember an answer, its ids turned into database numbers: ids are new in every run."""
        named = Answer(
            _numbers(answer.views, images),
            None if answer.before is None else _numbers(answer.before, images),
            answer.scores,
            float(answer.confidence),
            answer.status,
            dict(answer.timing_ms),
            dict(answer.features),
        )
        self.answers[query] = named
        self._write({"query": query} | asdict(named))

    def _write(self, line: Mapping[str, object]) -> None:
        if self.path is not None:
            with self.path.open("a") as lines:
                lines.write(json.dumps(line) + "\n")

    def results(self, depth: int) -> Answers:
        """All answers, in the order of the queries."""
        answers = [self.answers[query] for query in range(self.count)]
        stages = sorted({stage for a in answers for stage in a.timing_ms})
        evidence = sorted({name for a in answers for name in a.features})
        known = all(a.before is not None for a in answers if a.views)
        return Answers(
            method=self.method,
            ranked=_table([a.views for a in answers], depth),
            confidence=np.array([a.confidence for a in answers], np.float64),
            before=_table([a.before or () for a in answers], depth) if known else None,
            claimed=np.array([a.status == "matched" for a in answers], np.bool_),
            calibrated=True,
            timing_ms={s: np.array([a.timing_ms[s] for a in answers if s in a.timing_ms]) for s in stages},
            features={name: np.array([a.features.get(name, 0.0) for a in answers]) for name in evidence},
            refused=dict(Counter(self.codes.values())),
        )


def fingerprint(dataset: Dataset, recipe: str, seed: int, depth: int) -> str:
    """16 hex digits that change with anything that would change an answer: files, truth, recipe, seed."""
    parts: list[object] = [dataset.name, dataset.truth, recipe, seed, depth]
    files = (*dataset.database, *dataset.queries)
    # Of what is in them: an image that was turned in place keeps its name, and often its size.
    known = {path: digest(path) for path in dict.fromkeys(files)}
    parts += [[path.name, known[path]] for path in files]
    parts += [p.tolist() for p in dataset.positives]
    parts += [None if array is None else array.tolist() for array in (dataset.allowed, dataset.database_positions)]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:16]


def ranked_by(distances: Floats, dataset: Dataset, method: str, depth: int = 20) -> Answers:
    """The answers of a baseline from its distances (queries, database), what a query may not know left out."""
    known = np.array(distances, np.float64)
    if dataset.allowed is not None:
        known[np.arange(known.shape[1]) >= dataset.allowed[:, None]] = np.inf
    for row, ignored in zip(known, dataset.ignored or (), strict=dataset.ignored is not None):
        row[ignored] = np.inf
    order = np.argsort(known, axis=1, kind="stable")[:, :depth]
    nearest = np.take_along_axis(known, order, axis=1)
    order[np.isinf(nearest)] = -1
    best = nearest[:, 0] if known.shape[1] else np.full(len(known), np.inf)
    # Infinitely far means nothing to answer with: below any answer.
    confidence = np.where(np.isinf(best), -np.finfo(np.float64).max, -best)
    return Answers(method, order.astype(np.int64), confidence)


def _most_ignored(dataset: Dataset) -> int:
    """How many answers to one query may have to be left out."""
    return max(map(len, dataset.ignored), default=0) if dataset.ignored is not None else 0


def _without_ignored(answers: Answers, dataset: Dataset, depth: int) -> Answers:
    """Answers without images that are ignored, cut to `depth`.

    Confidences, verdicts and evidence are of first answers, some of which may be gone: there are none then.
    """
    if dataset.ignored is None:
        return answers

    def judged(ranked: Indices) -> Indices:
        kept = np.full((len(ranked), depth), -1, np.int64)
        for line, row, ignored in zip(kept, ranked, dataset.ignored or (), strict=True):
            left = row[~np.isin(row, ignored)][:depth]
            line[: len(left)] = left
        return kept

    before = None if answers.before is None else judged(answers.before)
    return replace(
        answers,
        ranked=judged(answers.ranked),
        before=before,
        confidence=None,
        claimed=None,
        calibrated=False,
        features={},
    )


def counted(progress: Progress | None, what: str, total: int) -> Callable[[], None]:
    """A tick for baselines that reports how many images have been described."""
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        (progress or _silent)(what, done, total)

    return tick


def _table(rows: list[tuple[str, ...]], depth: int) -> Indices:
    table = np.full((len(rows), depth), -1, np.int64)
    for line, row in zip(table, rows, strict=True):
        line[: len(row)] = [int(v) for v in row[:depth]]
    return table


def _numbers(views: tuple[str, ...], images: Mapping[str, list[int]]) -> tuple[str, ...]:
    """Database numbers of views; one view stands for several images when these are the same file, byte for byte."""
    unknown = next((v for v in views if v not in images), None)
    if unknown is not None:
        raise SetupError(f"the service answered with {unknown}, which was not enrolled in this run: use an empty map")
    return tuple(str(image) for view in views for image in images[view])


def position_of(dataset: Dataset, image: int) -> Position:
    """Where a database image was taken; empty where that is not known."""
    if dataset.database_positions is None:
        return Position()
    x, y = (float(v) for v in dataset.database_positions[image])
    return Position(x=x, y=y)


def _silent(what: str, done: int, total: int) -> None:
    """Show no progress."""
