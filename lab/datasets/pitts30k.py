"""Pittsburgh 30k: street views with UTM positions, by the NetVLAD structure or by file names."""

from pathlib import Path
from typing import Any, Literal

import numpy as np

from lab.datasets.dataset import RADIUS_M, Dataset, UnexpectedLayout, within
from lab.datasets.utm_names import images_with_positions
from lab.libraries import for_studies
from lab.metrics.recall import Indices
from schemas.description import Doubles

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
        files, positions, query_files, query_positions = _from_table(root, table)
    elif by_name.is_dir():
        files, positions = images_with_positions(by_name / "database", EXPECTED)
        query_files, query_positions = images_with_positions(by_name / "queries", EXPECTED)
    else:
        raise UnexpectedLayout(root, f"neither datasets/{table.name} nor images/{split} is there", EXPECTED)
    generator = np.random.default_rng(seed)
    kept, chosen = _draw(len(files), database, generator), _draw(len(query_files), queries, generator)
    subset = "" if queries is None and database is None else f", {len(chosen)} queries and {len(kept)} drawn"
    return [
        Dataset(
            name=f"pitts30k {split}{subset}",
            database=tuple(files[i] for i in kept),
            queries=tuple(query_files[i] for i in chosen),
            positives=tuple(within(positions[kept], query_positions[chosen], radius_m)),
            truth=f"within {radius_m:g} m (UTM)",
            database_positions=positions[kept],
            query_positions=query_positions[chosen],
        )
    ]


def _draw(total: int, count: int | None, generator: np.random.Generator) -> Indices:
    """`count` of `total` indices, ascending; all of them when that is fewer."""
    if count is None or count >= total:
        return np.arange(total, dtype=np.int64)
    return np.sort(generator.choice(total, count, replace=False)).astype(np.int64)


def _from_table(root: Path, table: Path) -> tuple[list[Path], Doubles, list[Path], Doubles]:
    """Files and positions of the database, then of the queries."""
    content = _read(table).get("dbStruct")
    if not isinstance(content, dict) or any(f not in content for f in FIELDS):
        raise UnexpectedLayout(table, f"no struct dbStruct with the fields {', '.join(FIELDS)}", EXPECTED)
    names, positions, query_names, query_positions = (np.atleast_1d(content[f]) for f in FIELDS)
    files = [root / str(name) for name in names]
    query_files = [root / "queries_real" / str(name) for name in query_names]
    sizes = f"{positions.shape} and {query_positions.shape}"
    if positions.size != 2 * len(files) or query_positions.size != 2 * len(query_files):
        problem = f"utmDb and utmQ must be 2 x {len(files)} and 2 x {len(query_files)}"
        raise UnexpectedLayout(table, f"{problem}, not {sizes}", EXPECTED)
    missing = [p for p in files + query_files if not p.is_file()]
    if missing:
        problem = f"{len(missing)} of {len(files) + len(query_files)} images are not there, first {missing[0]}"
        raise UnexpectedLayout(table, problem, EXPECTED)
    return files, _columns(positions), query_files, _columns(query_positions)


def _read(table: Path) -> dict[str, Any]:
    """The variables of a MAT-file, structs as dicts; arrays with one row or column are vectors."""
    with for_studies():
        from scipy.io import loadmat  # type: ignore[import-untyped]
    try:
        variables: dict[str, Any] = loadmat(table, simplify_cells=True)
    except NotImplementedError:
        raise UnexpectedLayout(table, "a MAT-file of version 7.3; save it with -v7", EXPECTED) from None
    except Exception as error:  # whatever a damaged file makes the reader stumble over
        raise UnexpectedLayout(table, f"no MAT-file that can be read: {error}", EXPECTED) from None
    return variables


def _columns(positions: Doubles) -> Doubles:
    """Positions of shape (2, n), or (2,) of a single one, as float64 (n, 2)."""
    return np.asarray(positions, np.float64).reshape(2, -1).T
