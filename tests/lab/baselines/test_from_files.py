"""Another method is measured by what it left in a file."""

from pathlib import Path

import numpy as np
import pytest

from lab.baselines.from_files import Descriptors, Ranked, named
from schemas.errors import InvalidParameters

DATABASE = [Path("/set/database/0.jpg"), Path("/set/database/1.jpg"), Path("/set/database/2.jpg")]
QUERIES = [Path("/set/query/0.jpg"), Path("/set/query/1.jpg")]
INF = np.inf


def nothing() -> None:
    pass


def written(folder: Path, text: str) -> Path:
    path = folder / "ranked.txt"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "distances"),
    [
        ("query/0.jpg database/2.jpg\nquery/0.jpg database/0.jpg\nquery/1.jpg 1.jpg\n", [[1, INF, 0], [INF, 2, INF]]),
        ("\ufeffquery,database,distance\n0.jpg,2.jpg,0.5\n1.jpg,0.jpg,7\n", [[INF, INF, 0.5], [7, INF, INF]]),
        ("query,database,distance\n0.jpg,2.jpg,0.5\n1.jpg,0.jpg,7\n\n", [[INF, INF, 0.5], [7, INF, INF]]),
        (
            "/set/query/0.jpg,0.jpg\nquery/1.jpg,0.jpg\nelsewhere.jpg,0.jpg\n1.jpg,none.jpg\n",
            [[0, INF, INF], [1, INF, INF]],
        ),
        (
            '"query/0.jpg", "0.jpg", 3\n"query/1.jpg", "0.jpg", 2\n"query/0.jpg", "0.jpg", 1',
            [[1, INF, INF], [2, INF, INF]],
        ),
    ],
)
def test_ranked_lists(tmp_path: Path, text: str, distances: list[list[float]]) -> None:
    found = Ranked("theirs", written(tmp_path, text)).rank(DATABASE, QUERIES, nothing)
    assert found.tolist() == distances


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("query/0.jpg\n", "line 1: needs a query"),
        ("0.jpg,1.jpg,near\n", "line 1: needs a query"),
        ("0.jpg,1.jpg,1\n1.jpg,1.jpg,nan\n", "line 2: needs a query, .* a finite number"),
        ("0.jpg 1.jpg\n", "lists nothing for 1 of 2 images: /set/query/1.jpg"),
        ("", "lists nothing for 2 of 2 images"),
    ],
)
def test_lists_that_cannot_be_used(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InvalidParameters, match=said):
        Ranked("theirs", written(tmp_path, text)).rank(DATABASE, QUERIES, nothing)


def test_descriptors(tmp_path: Path) -> None:
    names = ["query/1.jpg", "database/0.jpg", "database/1.jpg", "database/2.jpg", "query/0.jpg", "other.jpg"]
    path = tmp_path / "theirs.npz"
    np.savez(path, names=names, descriptors=np.array([[0, 4], [0, 0], [3, 0], [0, 4], [3, 0], [9, 9]]))
    found = Descriptors("theirs", path).rank(DATABASE, QUERIES, nothing)
    assert found == pytest.approx(np.array([[3, 0, 5], [4, 5, 0]]), abs=1e-6)


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"names": ["0.jpg"]}, "cannot be read"),
        ({"names": ["0.jpg"], "descriptors": np.zeros((2, 3))}, "a row for each name"),
        ({"names": ["0.jpg"], "descriptors": np.full((1, 3), np.nan)}, "a row for each name"),
        ({"names": ["0.jpg"], "descriptors": np.zeros((1, 3))}, "has no descriptors of 2 of 3 images"),
    ],
)
def test_descriptors_that_cannot_be_used(tmp_path: Path, arrays: dict[str, object], said: str) -> None:
    np.savez(tmp_path / "theirs.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(InvalidParameters, match=said):
        Descriptors("theirs", tmp_path / "theirs.npz").rank(DATABASE, QUERIES, nothing)


def test_a_file_that_is_none_is_named(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("names")
    np.savez(tmp_path / "whole.npz", names=["0.jpg"], descriptors=np.zeros((1, 3)))
    (tmp_path / "half.npz").write_bytes((tmp_path / "whole.npz").read_bytes()[:200])
    for path in (tmp_path / "missing.npz", tmp_path / "text.npz", tmp_path / "half.npz"):
        with pytest.raises(InvalidParameters, match=path.name):
            Descriptors("theirs", path).rank(DATABASE, QUERIES, nothing)


def test_methods_are_named_or_take_the_name_of_their_file() -> None:
    assert named(["my way=a/b.txt", "a/c.txt"], Ranked) == [
        Ranked("my way", Path("a/b.txt")),
        Ranked("c", Path("a/c.txt")),
    ]


def test_files_of_runs_that_are_named_by_their_settings_are_found(tmp_path: Path) -> None:
    path = tmp_path / "lr=0.1,wd=0" / "ranked.txt"
    path.parent.mkdir()
    path.touch()
    assert named([f"mine={path}", str(path), f"k=5={path}"], Ranked) == [
        Ranked("mine", path),
        Ranked("ranked", path),
        Ranked("k=5", path),
    ]
    assert named(["mine=lr=0.1/absent.txt"], Ranked) == [Ranked("mine", Path("lr=0.1/absent.txt"))]
