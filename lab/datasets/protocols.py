"""Maps to enrol from one set, and queries to decide about: of known places, of unknown ones, of other sites.

The trap is in what is unknown. An image next to a removed one shows the same things, and a robot that takes it for its
place is hardly wrong: whatever lies near a cut is left out of judging (`hold_out` tells of the same).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lab.datasets.dataset import Dataset, images_in
from lab.datasets.layout import layout
from lab.metrics.decisions import Kind
from lab.metrics.recall import Indices
from schemas.description import Booleans

RUN = 10
"""Neighbouring queries of a walk that make a block: intervals draw them together."""

GUARD = 2
"""Width of the guard band in tolerances of the truth: so far from an enrolled image, and more, a place is unknown."""

STRETCHES = 4
"""Stretches of the database in turn enrolled and not; two where so many would be too short."""

SHORTEST = 4
"""Length of a stretch in widths of its guard band (a tolerance included): shorter ones leave little to judge."""

MOST_PARTS = 5
"""A set of more parts (series of files) has no floors to be left out one by one."""

UNKNOWN = "unknown"
"""Folder beside a set's database: images of the same site, of places that are not in the database."""

EXPECTED = f"""\
  SET/{UNKNOWN}/   images of the same site, of places that are in no database folder"""


@dataclass(frozen=True, eq=False)
class Query:
    """An image to decide about.

    Parameters
    ----------
    image : Path
    kind : str
        ``known``, ``same-site`` or ``other-site``.
    right : int64 of shape (right answers,)
        Indices into the set's whole database, enrolled or not; empty at another site.
    block : str
        Queries of one block resemble each other.
    """

    image: Path
    kind: Kind
    right: Indices
    block: str


@dataclass(frozen=True, eq=False)
class Trial:
    """A map and the queries that it gets.

    Parameters
    ----------
    protocol : str
        What is pooled over sets.
    dataset : Dataset
    enrolled : int64 of shape (images,)
        Indices into the database, ascending.
    queries : tuple of Query
    """

    protocol: str
    dataset: Dataset
    enrolled: Indices
    queries: tuple[Query, ...]


def whole(dataset: Dataset, others: Sequence[Query] = ()) -> Trial:
    """Everything enrolled; the set's own queries, its folder of unknown places, and queries of other sites."""
    everything = np.arange(len(dataset.database), dtype=np.int64)
    return Trial("everything", dataset, everything, (*_judged(dataset, everything, 0), *unknown(dataset), *others))


def halves(dataset: Dataset, stretches: int = STRETCHES, guard: int = GUARD) -> list[Trial]:
    """Two maps of every other stretch of the database: what one knows, the other does not.

    Parameters
    ----------
    dataset : Dataset
    stretches : int
        Even; of about as many places each, counting those that queries show.
    guard : int
        In tolerances of the ground truth. A query is judged only when all its right answers and all that lies so near
        to one of them are on the same side, so that each judged query is known once and unknown once. Between separate
        places there is no guard band.

    Raises
    ------
    ValueError
        Fewer places than stretches, or an odd number of these.
    """
    found = layout(dataset)
    shown = np.unique(found.unit[np.concatenate(dataset.positives)])
    if len(shown) < stretches or stretches % 2:
        raise ValueError(f"{dataset.name}: {len(shown)} places do not make {stretches} stretches in two halves")
    if len(shown) < stretches * SHORTEST * (1 + guard) * found.tolerance:
        stretches = 2
    before = np.searchsorted(shown, found.unit, side="right") - 1
    second = (before.clip(0) * stretches // len(shown)) % 2 == 1
    trials = []
    for enrolled in (~second, second):
        chosen = np.flatnonzero(enrolled)
        queries = _judged(dataset, chosen, guard, whole_band=True)
        trials.append(Trial("half of the places", dataset, chosen, queries))
    return trials


def without_parts(dataset: Dataset, guard: int = GUARD) -> list[Trial]:
    """Maps that each leave one part out, such as a floor that looks like the others; none where there are no parts."""
    found = layout(dataset)
    parts = np.unique(found.part)
    if not 1 < len(parts) <= MOST_PARTS:
        return []
    trials = []
    for part in parts:
        enrolled = np.flatnonzero(found.part != part)
        trials.append(Trial("a part left out", dataset, enrolled, _judged(dataset, enrolled, guard)))
    return trials


def small_maps(
    dataset: Dataset,
    size: int,
    draws: int,
    generator: np.random.Generator,
    others: Sequence[Query] = (),
    *,
    spread: bool = False,
    guard: int = GUARD,
) -> list[Trial]:
    """Maps of a few places each, with all queries that know or do not know one of them.

    Parameters
    ----------
    dataset : Dataset
    size : int
        Places enrolled; of a walk each image is one. No map is made when there are not so many.
    draws : int
        Maps; one is enough when it holds everything.
    generator : numpy.random.Generator
    others : sequence of Query
        Of other sites, made of each map.
    spread : bool
        Places from everywhere. Otherwise one contiguous stretch (around the end), as a short drive enrols them.
    guard : int
    """
    found = layout(dataset)
    places = int(found.unit.max()) + 1
    trials = []
    for _ in range(draws if size < places else int(size == places)):
        start = int(generator.integers(places))
        drawn = generator.choice(places, size, replace=False) if spread else (start + np.arange(size)) % places
        enrolled = np.flatnonzero(np.isin(found.unit, drawn))
        queries = (*_judged(dataset, enrolled, guard), *others)
        trials.append(Trial(f"{size} place{'s' * (size > 1)}", dataset, enrolled, queries))
    return trials


def unknown(dataset: Dataset) -> tuple[Query, ...]:
    """Images in the folder ``unknown`` beside the database: same site, never enrolled. None where there is none."""
    folder = dataset.database[0].parent.parent / UNKNOWN
    if not folder.is_dir():
        return ()
    nothing = np.zeros(0, np.int64)
    found = images_in(folder, EXPECTED)
    return tuple(Query(path, "same-site", nothing, f"{_short(folder)} {i // RUN}") for i, path in enumerate(found))


def site(dataset: Dataset) -> str:
    """Where a set was taken: its folder's name up to the first underscore, as ``pepper`` of two walks in one office."""
    return site_named(dataset.database[0].parent.parent.name)


def site_named(name: str) -> str:
    """The site of a set by the set's name, which begins with that of its folder."""
    return name.partition(" ")[0].partition("_")[0]


def elsewhere(dataset: Dataset, others: Sequence[Dataset]) -> tuple[Query, ...]:
    """Queries of all sets of other sites, each image once."""
    nothing = np.zeros(0, np.int64)
    found: dict[Path, Query] = {}
    for other in others:
        if site(other) == site(dataset):
            continue
        for path, block in zip(other.queries, blocks(other), strict=True):
            found.setdefault(path, Query(path, "other-site", nothing, block))
    return tuple(found.values())


def blocks(dataset: Dataset) -> list[str]:
    """Which queries resemble each other: runs of ten along a walk, those of one place where places are separate."""
    found = layout(dataset)
    folder = _short(dataset.queries[0].parent)
    if not found.named:
        return [f"{folder} {i // RUN if found.walk else i}" for i in range(len(dataset.queries))]
    return [
        f"{folder} place {found.unit[p[0]]}" if len(p) else f"{folder} {path.name}"
        for p, path in zip(dataset.positives, dataset.queries, strict=True)
    ]


def _short(folder: Path) -> str:
    """A folder's name after that of its set, which is the same wherever the sets lie."""
    return f"{folder.parent.name}/{folder.name}"


def _judged(dataset: Dataset, enrolled: Indices, guard: int, *, whole_band: bool = False) -> tuple[Query, ...]:
    """The set's own queries that are clearly known to a map or clearly not; those without any right answer are neither.

    Known: a right answer is enrolled; with `whole_band` all of them, and all within the guard band. Unknown: nothing
    within the guard band is.
    """
    found = layout(dataset)
    there: Booleans = np.isin(np.arange(len(dataset.database)), enrolled)
    queries = []
    for image, right, block in zip(dataset.queries, dataset.positives, blocks(dataset), strict=True):
        if len(right) == 0:
            continue
        band = there[found.near(right, guard * found.tolerance)]
        if band.all() if whole_band else there[right].any():
            queries.append(Query(image, "known", right, block))
        elif not band.any():
            queries.append(Query(image, "same-site", right, block))
    return tuple(queries)
