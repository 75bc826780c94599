"""Pittsburgh 30k: street views with UTM positions, by the NetVLAD structure or by file names."""

import re
from pathlib import Path
from typing import Literal

import numpy as np

from lab.datasets.dataset import RADIUS_M, Dataset, UnexpectedLayout, images_in, within
from lab.datasets.matlab import NotMatlab, read_matlab
from lab.metrics.recall import Doubles, Indices

EXPECTED = """\
either, as NetVLAD's authors hand it out,
  ROOT/datasets/pitts30k_val.mat      (dbStruct: dbImageFns, utmDb, qImageFns, utmQ)
  ROOT/000/000000_pitch1_yaw1.jpg ... (database), ROOT/queries_real/... (queries)
or, as VPR-datasets-downloader writes it,
  ROOT/images/val/database/@0584353.20@4477041.69@...@.jpg
  ROOT/images/val/queries/...         (easting and northing in the name)"""

FIELDS = ("dbImageFns", "utmDb", "qImageFns", "utmQ")


def read(
    root: Path,
    *,
    split: Literal["train", "val", "test"] = "val",
    radius_m: float = RADIUS_M,
    queries: int | None = None,
    database: int | None = None,
    seed: int = 0,
) -> list[Dataset]:
    """One split as one set, whole or a seeded subset.

    Parameters
    ----------
    root : Path
    split : str
    radius_m : float
    queries, database : int or None
        Draw this many at random; None takes all. The two are drawn independently of each other, so that the
        database keeps its distractors and chance stays what it is in the whole set; some queries lose their right
        answers, and the report counts how many have one. A database made of the queries' positives alone, as in the
        paper's code, makes nearly everything right for somebody (docs/evaluation.md).
    seed : int

    Raises
    ------
    UnexpectedLayout
        When neither layout is there, or it is not complete.
    """
    table = root / "datasets" / f"pitts30k_{split}.mat"
    by_name = root / "images" / split
    if table.is_file():
        files, positions, results, asked_at = _from_table(root, table)
    elif by_name.is_dir():
        files, positions = _from_names(by_name / "database")
        results, asked_at = _from_names(by_name / "queries")
    else:
        raise UnexpectedLayout(root, f"neither datasets/{table.name} nor images/{split} is there", EXPECTED)
    generator = np.random.default_rng(seed)
    kept, chosen = _draw(len(files), database, generator), _draw(len(results), queries, generator)
    subset = "" if queries is None and database is None else f", {len(chosen)} queries and {len(kept)} drawn"
    return [
        Dataset(
            name=f"pitts30k {split}{subset}",
            database=tuple(files[i] for i in kept),
            queries=tuple(results[i] for i in chosen),
            positives=tuple(within(positions[kept], asked_at[chosen], radius_m)),
            truth=f"within {radius_m:g} m (UTM)",
            database_positions=positions[kept],
            query_positions=asked_at[chosen],
        )
    ]


def _draw(total: int, count: int | None, generator: np.random.Generator) -> Indices:
    """`count` of `total` indices, ascending; all of them when that is fewer."""
    if count is None or count >= total:
        return np.arange(total, dtype=np.int64)
    return np.sort(generator.choice(total, count, replace=False)).astype(np.int64)


def _from_table(root: Path, table: Path) -> tuple[list[Path], Doubles, list[Path], Doubles]:
    try:
        variables = read_matlab(table)
    except NotMatlab as error:
        raise UnexpectedLayout(table, str(error), EXPECTED) from None
    content = variables.get("dbStruct")
    if not isinstance(content, dict) or any(f not in content for f in FIELDS):
        raise UnexpectedLayout(table, f"no struct dbStruct with the fields {', '.join(FIELDS)}", EXPECTED)
    files = [root / name for name in content["dbImageFns"]]
    results = [root / "queries_real" / name for name in content["qImageFns"]]
    positions, asked_at = (np.asarray(content[f], np.float64).T for f in ("utmDb", "utmQ"))
    if positions.shape != (len(files), 2) or asked_at.shape != (len(results), 2):
        problem = f"utmDb and utmQ must be 2 x {len(files)} and 2 x {len(results)}"
        raise UnexpectedLayout(table, f"{problem}, not {positions.T.shape} and {asked_at.T.shape}", EXPECTED)
    missing = [p for p in files + results if not p.is_file()]
    if missing:
        problem = f"{len(missing)} of {len(files) + len(results)} pictures are not there, first {missing[0]}"
        raise UnexpectedLayout(table, problem, EXPECTED)
    return files, positions, results, asked_at


def _from_names(folder: Path) -> tuple[list[Path], Doubles]:
    files = images_in(folder, EXPECTED)
    positions = []
    for path in files:
        found = re.match(r"@\s*(\d+(?:\.\d+)?)@\s*(\d+(?:\.\d+)?)@", path.name)
        if found is None:
            raise UnexpectedLayout(folder, f"{path.name} does not begin with @easting@northing@", EXPECTED)
        positions.append((float(found[1]), float(found[2])))
    return files, np.array(positions)
