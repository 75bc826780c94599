"""The command line of rivals: protocols, what orders answers anew, and what is refused before a long run."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lab.baselines.random_order import RandomOrder
from lab.datasets.dataset import Dataset
from lab.datasets.tutorial import diagonal
from lab.evaluate import main, run
from lab.evaluation.contender import Contender
from lab.evaluation.html import as_html
from lab.evaluation.querying import Retriever
from lab.evaluation.reranking import Reranking
from lab.evaluation.tables import as_json, as_text
from tests.lab.datasets.drawn import image
from tests.lab.fakes import FakeRetriever, walk


class ByNumber:
    """Images are named by their places: the nearer, the more inliers."""

    name = "verified"

    def __init__(self) -> None:
        self.pairs: list[tuple[str, str]] = []

    def inliers(self, query: Path, image: Path) -> int:
        self.pairs.append((query.stem, image.stem))
        return 100 - abs(int(query.stem) - int(image.stem))


class Offset:
    """Ranks the frame three before the right one first, then on from there."""

    name = "offset"

    def rank(self, database: Sequence[Path], queries: Sequence[Path], tick: object) -> np.ndarray:
        numbers = np.array([int(path.stem) for path in database])
        wanted = np.array([int(path.stem) for path in queries])[:, None]
        return np.where(numbers >= wanted - 3, numbers - wanted + 3, 1000).astype(np.float32)


def test_the_first_answers_of_one_method_are_ordered_anew(tmp_path: Path) -> None:
    dataset, verifier = walk(tmp_path, 20), ByNumber()
    rerankings = [Reranking(verifier, "offset", 5), Reranking(verifier, "nobody", 5)]

    found = run(dataset, [], [Offset(), RandomOrder()], rerankings=rerankings).evaluation

    assert [m.method for m in found.methods] == ["offset", "offset, verified", "random"]
    plain, verified, _ = found.methods
    assert plain.first[5] == 3, "the frame before the right one is right too"
    assert verified.first[5] == 1
    assert {query for query, _ in verifier.pairs} == {str(i) for i in range(20)}
    assert [image for query, image in verifier.pairs if query == "5"] == ["2", "3", "4", "5", "6"]


def test_answers_behind_the_first_stay_behind(tmp_path: Path) -> None:
    dataset = walk(tmp_path, 20)
    found = run(dataset, [], [Offset()], rerankings=[Reranking(ByNumber(), "offset", 2)]).evaluation
    # Of frames 2 and 3 the nearer comes first; 4 is right and stays third.
    assert found.methods[1].first[5] == 3


def test_a_query_without_answers_has_none_afterwards(tmp_path: Path) -> None:
    whole = walk(tmp_path, 20)
    nothing = tuple(np.zeros(0, np.int64) for _ in whole.queries)
    blind = Dataset("blind", whole.database, whole.queries, nothing, "none", allowed=np.zeros(20, np.int64))
    verifier = ByNumber()
    run(blind, [], [Offset()], rerankings=[Reranking(verifier, "offset", 5)])
    assert verifier.pairs == []


@pytest.fixture
def pairs(tmp_path: Path) -> Path:
    rows = ["query_folder,query_file,database_folder,database_file"]
    for i in range(30):
        image(tmp_path / "d" / f"{i:02}.jpg", i)
        image(tmp_path / "q" / f"{i:02}.jpg", i)
        rows.append(f"q,{i:02}.jpg,d,{i:02}.jpg")
    (tmp_path / "ground_truth.csv").write_text("\n".join(rows) + "\n")
    return tmp_path


def test_the_tutorials_protocol_on_the_command_line(pairs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["pairs", "--root", str(pairs), "--no-service", "--baselines", "tiny", "--protocol", "vpr-tutorial"]
    assert main([*command, "--out", str(pairs / "out")]) == 0
    told = capsys.readouterr().out
    assert "(vpr-tutorial)" in told
    assert "right: the frame of the same number; 8 before and after it are ignored" in told
    assert "tiny image  1.000" in told


def test_a_report_of_the_tutorials_protocol_says_nothing_of_confidence(tmp_path: Path) -> None:
    whole = walk(tmp_path, 40)
    dataset = diagonal(replace(whole, queries=whole.queries[:30], positives=whole.positives[:30]))

    @contextmanager
    def fake(_: Dataset) -> Iterator[Retriever]:
        yield FakeRetriever(lambda a, b: 1 - abs(a - b) / 100)

    outcome = run(dataset, [Contender(fake)], [], rerankings=[Reranking(ByNumber(), "fake", 5)], examples=0)

    [service, _, verified] = outcome.evaluation.methods
    assert (service.known_place, service.calibrated) == (None, None)
    assert service.recall[0].value == verified.recall[0].value == 1
    assert "calibration" not in as_text(outcome.evaluation)
    page = as_html([outcome.evaluation], {}, "tutorial")
    assert "8 before and after it are ignored" in page
    assert '"confidence"' not in as_json([outcome.evaluation])


def test_a_set_is_exported_by_names_and_evaluated_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "set").mkdir()
    rows = ["file,x,y"]
    for i in range(6):
        for role in ("database", "query"):
            image(tmp_path / "set" / role / f"{i}.jpg", i)
            rows.append(f"{role}/{i}.jpg,{100 * i},0")
    (tmp_path / "set" / "positions.csv").write_text("\n".join(rows) + "\n")
    out = ["--out", str(tmp_path / "out")]
    assert main(["folder", "--root", str(tmp_path / "set"), "--export", str(tmp_path / "there"), *out]) == 0
    assert "6 images in database, 6 in queries" in capsys.readouterr().out
    command = ["folder", "--root", str(tmp_path / "there"), "--protocol", "utm", "--no-service", "--baselines", "tiny"]
    assert main([*command, *out]) == 0
    assert "tiny image  1.000" in capsys.readouterr().out


def test_a_set_in_a_folder_whose_name_is_not_utf8_is_evaluated(tmp_path: Path) -> None:
    """OpenCV crashed, and the report could not be written."""
    for i in range(3):
        for role in ("database", "query"):
            image(tmp_path / "set" / role / f"{i}.jpg", i)
    root = (tmp_path / "set").rename(tmp_path / os.fsdecode(b"caf\xe9"))
    out = ["--out", str(tmp_path / "out")]
    assert main(["aligned", "--root", str(root), "--no-service", "--baselines", "tiny", *out]) == 0
    assert "caf\\udce9" in (tmp_path / "out" / "report.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--protocol", "loop"], "loop is none of pairs's; there are: vpr-tutorial"),
        (["--protocol", "vpr-tutorial", "--hold-out", "0.3"], "nothing can be held out"),
        (["--rerank", "default", "--no-service"], "default is not measured here; there are tiny image"),
        (["--rerank", "tiny image", "--no-service"], "--aliked-lightglue FOLDER"),
        (["--rerank", "tiny image", "--no-service", "--aliked-lightglue", "X", "--rerank-first", "0"], "1 or more"),
        (["--baselines", "anyloc", "--no-service"], "--dinov2 FILE"),
        (["--export", "there"], "has no positions"),
        (["--no-service", "--ranked", "mine=nowhere.txt"], "file: there is no nowhere.txt"),
        (["--no-service", "--descriptors", "nowhere.npz"], "file: there is no nowhere.npz"),
        (["--no-service", "--ranked", f"tiny image={__file__}"], "two are called tiny image"),
        (["--no-service", "--baselines", "none"], "there are none to measure"),
    ],
)
def test_what_cannot_be_measured_is_said_at_once(
    pairs: Path, options: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["pairs", "--root", str(pairs), "--baselines", "tiny", "--out", str(pairs / "out")]
    assert main([*command, *options]) == 2
    assert says in capsys.readouterr().err
    assert not (pairs / "out").exists()
