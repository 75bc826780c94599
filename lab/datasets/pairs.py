"""Folders of images with a table of right answers."""

from pathlib import Path

import numpy as np

from lab.datasets.dataset import Dataset, UnexpectedLayout, composed, images_in, rows_of

COLUMNS = ("query_folder", "query_file", "database_folder", "database_file")

EXPECTED = """\
  ROOT/ground_truth.csv    with the columns query_folder,query_file,database_folder,database_file;
                           each row is one right answer to one query
  ROOT/<query_folder>/...  images
  ROOT/<database_folder>/...
ROOT may also be a folder of such folders."""


def read(root: Path, *, table: str = "ground_truth.csv", unlisted: bool = False) -> list[Dataset]:
    """One set for each pair of folders in the table.

    Parameters
    ----------
    root : Path
    table : str
        Name of the table.
    unlisted : bool
        Whether images of a query folder that no row names are queries without a right answer. Off by
        default: an image may be absent from a table because nobody looked, not because its place is unknown.

    Returns
    -------
    list of Dataset
        By name of the set, then in order of first mention.

    Raises
    ------
    UnexpectedLayout
        When there is no table, or it names an image that is not there.
    """
    tables = [root / table] if (root / table).is_file() else sorted(root.glob(f"*/{table}"))
    if not tables:
        raise UnexpectedLayout(root, f"no {table} in it or one level below", EXPECTED)
    return [dataset for path in tables for dataset in _sets(path, unlisted)]


def _sets(table: Path, unlisted: bool) -> list[Dataset]:
    folder = table.parent
    right: dict[tuple[str, str], dict[str, set[str]]] = {}
    for row in rows_of(table, COLUMNS, EXPECTED):
        pair = right.setdefault((row["query_folder"], row["database_folder"]), {})
        pair.setdefault(composed(row["query_file"]), set()).add(composed(row["database_file"]))
    sets = []
    for (queried, searched), answers in right.items():
        database = images_in(folder / searched, EXPECTED)
        queries = [p for p in images_in(folder / queried, EXPECTED) if unlisted or composed(p.name) in answers]
        number = {composed(p.name): i for i, p in enumerate(database)}
        missing = {f"{queried}/{q}" for q in answers.keys() - {composed(p.name) for p in queries}}
        missing |= {f"{searched}/{d}" for named in answers.values() for d in named - number.keys()}
        if missing:
            problem = f"{len(missing)} images that the table names are not there: {', '.join(sorted(missing)[:5])}"
            raise UnexpectedLayout(table, problem, EXPECTED)
        rights = ([number[name] for name in answers.get(composed(q.name), ())] for q in queries)
        positives = tuple(np.array(sorted(right), np.int64) for right in rights)
        name = f"{folder.name} {queried} -> {searched}"
        sets.append(Dataset(name, tuple(database), tuple(queries), positives, f"the pairs of {table.name}"))
    return sets
