"""The usual names with positions: read, written, and read again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lab.datasets import folder, utm_names
from lab.datasets.dataset import Dataset, UnexpectedLayout
from lab.datasets.utm_names import name_of
from schemas.errors import InvalidParameters
from tests.lab.datasets.drawn import image


def campus(root: Path) -> Dataset:
    """Two images with positions in a table, and two queries; one of each has the same name."""
    rows = ["file,x,y", "database/a.jpg,584353.2,4477041.69", "database/b@2.png,-12.345,0"]
    rows += ["query/a.jpg,584360,4477041", "query/c.jpg,100,100"]
    (root / "positions.csv").write_text("\n".join(rows) + "\n")
    for number, row in enumerate(rows[1:]):
        image(root / row.split(",")[0], number)
    [found] = folder.read(root)
    return found


def test_a_set_is_written_and_read_again(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    before = campus(tmp_path / "set")

    utm_names.export(before, tmp_path / "there")
    [after] = utm_names.read(tmp_path / "there")

    def described(one: Dataset) -> set[tuple[bytes, tuple[bytes, ...]]]:
        pairs = zip(one.queries, one.positives, strict=True)
        return {(q.read_bytes(), tuple(one.database[i].read_bytes() for i in right)) for q, right in pairs}

    assert described(after) == described(before)
    assert sorted(p.name for p in (tmp_path / "there" / "database").iterdir()) == [
        "@-000012.35@0000000.00@@@@@@@@@@@@b-2@.png",
        "@0584353.20@4477041.69@@@@@@@@@@@@a@.jpg",
    ]
    assert after.database_positions is not None
    assert after.database_positions[np.argmax(after.database_positions[:, 0])].tolist() == [584353.2, 4477041.69]


def test_a_name_has_fourteen_fields() -> None:
    name = name_of((1.0, 2.0), "frame/7", ".jpg")
    assert name == "@0000001.00@0000002.00@@@@@@@@@@@@frame-7@.jpg"
    assert len(name.split("@")[1:-1]) == 14


def test_names_of_others_are_read(tmp_path: Path) -> None:
    image(tmp_path / "database" / "@0584353.20@4477041.69@17@T@040.44183@-080.00301@000@01@@@@@@@.jpg")
    image(tmp_path / "queries" / "@ 584363.2@4477041@.jpg")
    [found] = utm_names.read(tmp_path, radius_m=11)
    assert [p.tolist() for p in found.positives] == [[0]]
    assert [p.tolist() for p in utm_names.read(tmp_path, radius_m=9)[0].positives] == [[]]


def test_what_cannot_be_read_is_explained(tmp_path: Path) -> None:
    image(tmp_path / "database" / "@1@2@.jpg")
    with pytest.raises(UnexpectedLayout, match="no such folder"):
        utm_names.read(tmp_path)
    image(tmp_path / "queries" / "1.jpg")
    with pytest.raises(UnexpectedLayout, match=r"1\.jpg does not begin with @easting@northing@"):
        utm_names.read(tmp_path)


def test_what_cannot_be_written_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    dataset, target = campus(tmp_path / "set"), tmp_path / "there"
    with pytest.raises(InvalidParameters, match="has no positions"):
        utm_names.export(replace(dataset, query_positions=None), target)
    twice = replace(dataset, database=(dataset.database[0],) * 2, database_positions=np.zeros((2, 2)))
    with pytest.raises(InvalidParameters, match="the same name and position"):
        utm_names.export(twice, target)
    assert not target.exists()
    target.mkdir()
    with pytest.raises(InvalidParameters, match="exists already"):
        utm_names.export(dataset, target)
