"""Pittsburgh in both layouts. The two .mat files were written by SciPy 1.17's savemat, one of them compressed."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat  # type: ignore[import-untyped]

from lab.datasets import pitts30k
from lab.datasets.dataset import UnexpectedLayout
from tests.lab.datasets.drawn import image

HERE = Path(__file__).parent
DATABASE = ("000/a_pitch1_yaw1.jpg", "000/b.jpg", "001/c.jpg")
QUERIES = ("000/q.jpg", "000/r.jpg")


def netvlad_layout(root: Path, which: str) -> Path:
    (root / "datasets").mkdir()
    (root / "datasets" / "pitts30k_val.mat").write_bytes((HERE / f"pitts30k_{which}.mat").read_bytes())
    for name in DATABASE:
        image(root / name)
    for name in QUERIES:
        image(root / "queries_real" / name)
    return root


def named_layout(root: Path, count: int = 3) -> Path:
    for i in range(count):
        image(root / f"images/val/database/@0584{i}00.20@4477041.69@17@T@040@.jpg")
        image(root / f"images/val/queries/@0584{i}10.00@4477041.69@17@T@040@.jpg")
    return root


@pytest.mark.parametrize("which", ["plain", "packed"])
def test_the_matlab_structure(tmp_path: Path, which: str) -> None:
    [found] = pitts30k.read(netvlad_layout(tmp_path, which))
    assert [p.relative_to(tmp_path).as_posix() for p in found.database] == list(DATABASE)
    assert [p.relative_to(tmp_path / "queries_real").as_posix() for p in found.queries] == list(QUERIES)
    assert [p.tolist() for p in found.positives] == [[0, 1], []]


def test_positions_in_file_names(tmp_path: Path) -> None:
    [found] = pitts30k.read(named_layout(tmp_path))
    assert [p.tolist() for p in found.positives] == [[0], [1], [2]]


def test_a_subset_is_seeded_and_keeps_distractors(tmp_path: Path) -> None:
    named_layout(tmp_path, 9)
    [a] = pitts30k.read(tmp_path, queries=2, database=6, seed=1)
    [b] = pitts30k.read(tmp_path, queries=2, database=6, seed=1)
    [c] = pitts30k.read(tmp_path, queries=2, database=6, seed=2)
    assert a.database == b.database
    assert a.queries == b.queries
    assert (a.database, a.queries) != (c.database, c.queries)
    # Six images for two queries: at least four are nobody's right answer.
    assert len({int(i) for p in a.positives for i in p}) <= 2
    assert len(a.database) == 6


def test_no_layout_at_all(tmp_path: Path) -> None:
    with pytest.raises(UnexpectedLayout, match=r"neither datasets/pitts30k_val\.mat nor images/val"):
        pitts30k.read(tmp_path)


def test_an_image_of_the_structure_is_missing(tmp_path: Path) -> None:
    netvlad_layout(tmp_path, "plain")
    (tmp_path / DATABASE[1]).unlink()
    with pytest.raises(UnexpectedLayout, match="1 of 5 images are not there"):
        pitts30k.read(tmp_path)


def test_a_name_without_position(tmp_path: Path) -> None:
    named_layout(tmp_path)
    image(tmp_path / "images/val/database/house.jpg")
    with pytest.raises(UnexpectedLayout, match=r"house\.jpg does not begin"):
        pitts30k.read(tmp_path)


@pytest.mark.parametrize("cut", [0, 100, 140, 700])
def test_a_damaged_structure_is_an_explained_refusal(tmp_path: Path, cut: int) -> None:
    table = netvlad_layout(tmp_path, "plain") / "datasets" / "pitts30k_val.mat"
    table.write_bytes(table.read_bytes()[:cut])
    with pytest.raises(UnexpectedLayout, match=r"no MAT-file that can be read|no struct dbStruct"):
        pitts30k.read(tmp_path)


def test_version_73_is_named(tmp_path: Path) -> None:
    table = netvlad_layout(tmp_path, "plain") / "datasets" / "pitts30k_val.mat"
    table.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + b"\0" * 384)
    with pytest.raises(UnexpectedLayout, match="-v7"):
        pitts30k.read(tmp_path)


def test_a_set_of_one_image_is_read(tmp_path: Path) -> None:
    layout = netvlad_layout(tmp_path, "plain")
    names = {"dbImageFns": np.array([[DATABASE[0]]], object), "qImageFns": np.array([[QUERIES[0]]], object)}
    named = names | {"utmDb": np.array([[1.0], [2.0]]), "utmQ": np.array([[4.0], [6.0]])}
    savemat(layout / "datasets" / "pitts30k_val.mat", {"dbStruct": named})
    [found] = pitts30k.read(tmp_path, radius_m=5)
    assert found.database_positions is not None
    assert found.database_positions.tolist() == [[1.0, 2.0]]
    assert [p.tolist() for p in found.positives] == [[0]]
