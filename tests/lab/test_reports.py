"""Reports say the same in text, JSON and HTML, and the HTML file needs nothing from outside."""

import base64
import json
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from lab.baselines.random_order import RandomOrder
from lab.baselines.tiny import TinyImage
from lab.datasets.dataset import Dataset
from lab.evaluate import Outcome, main, run
from lab.evaluation.contender import Contender
from lab.evaluation.html import Shown, as_html
from lab.evaluation.querying import Retriever
from lab.evaluation.tables import as_json, as_text, overview
from tests.lab.datasets.drawn import image
from tests.lab.fakes import FakeRetriever


class Painter:
    """An artist who draws the same twice."""

    def explain(self, query: Path, answer: Path) -> Sequence[Shown]:
        return [Shown("what <corresponds>", query.read_bytes())]

    def portray(self, one: Path) -> Sequence[Shown]:
        return [Shown("labels", one.read_bytes())]


@contextmanager
def fake(dataset: Dataset) -> Iterator[Retriever]:
    yield FakeRetriever(lambda a, b: 1 - abs(a - b) / 10)


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    root = tmp_path_factory.mktemp("walk & co")
    files = {(f, i): image(root / f / f"{i}.jpg", i) for f in "dq" for i in range(24)}
    positives = tuple(np.arange(max(0, i - 1), min(20, i + 2)) if i < 20 else np.zeros(0, np.int64) for i in range(24))
    database = tuple(files["d", i] for i in range(20))
    dataset = Dataset("walk <q> -> d", database, tuple(files["q", i] for i in range(24)), positives, "+-1 frame")
    return run(dataset, [Contender(fake, lambda _: Painter())], [RandomOrder()])


def test_text_names_chance_ceiling_and_verdicts(outcome: Outcome) -> None:
    text = as_text(outcome.evaluation)
    assert "24 queries, 20 of them answerable" in text
    assert "(chance)" in text
    assert "(ceiling)" in text
    assert "AT CHANCE: " in text
    assert "random (p = 0." in text
    assert "re-ranking changed recall@1 by" in text
    assert "calibration error" in text


def test_the_overview_has_a_row_for_each_set_and_a_column_for_each_method(outcome: Outcome) -> None:
    head, _, row = overview([outcome.evaluation]).splitlines()
    assert head == "| set | queries | *chance* | fake | fake, histograms alone | random |"
    assert row.count("|") == head.count("|")
    assert "| 1.000 (" in row


def test_json_can_be_read_back_and_recalls_recomputed(outcome: Outcome) -> None:
    [data] = json.loads(as_json([outcome.evaluation]))
    first = np.array(data["methods"][0]["first"])
    assert np.mean(first[:20] == 1) == data["methods"][0]["recall"][0]["value"]
    assert data["circumstances"]["seed"] == "0"


def test_html_is_self_contained_and_well_formed(outcome: Outcome) -> None:
    page = as_html([outcome.evaluation], {outcome.evaluation.dataset: outcome.examples})
    for link in re.findall(r'(?:src|href)="([^"]*)"', page):
        assert link.startswith(("data:image/", "#set")), link
    assert "<script" not in page
    assert "http" not in re.sub(r"base64,[A-Za-z0-9+/=]*", "", page)
    assert "walk &lt;q&gt;" in page
    assert "what &lt;corresponds&gt;" in page
    assert page == as_html([outcome.evaluation], {outcome.evaluation.dataset: outcome.examples})
    body = re.sub(r"<(meta|img|br)([^>]*)>", r"<\1\2/>", page.removeprefix("<!doctype html>"))
    ElementTree.fromstring(body)


def test_plots_are_vector_graphics_with_text(outcome: Outcome) -> None:
    page = as_html([outcome.evaluation], {})
    plots = [base64.b64decode(found).decode() for found in re.findall(r"image/svg\+xml;base64,([^\"]*)", page)]
    assert len(plots) == 4  # recall, known places, reliability, times
    for plot in plots:
        ElementTree.fromstring(plot)
        assert "nan" not in plot
    assert [word in plots[0] for word in ("recall@N", "chance", "ceiling", "fake")] == [True] * 4
    assert "1.5 / 1.5 ms" in plots[3]


def test_a_method_may_have_any_name(outcome: Outcome) -> None:
    method = replace(outcome.evaluation.methods[0], method=r"mine $\frac$ <b>")
    page = as_html([replace(outcome.evaluation, methods=(method,))], {})
    first = re.findall(r"image/svg\+xml;base64,([^\"]*)", page)[0]
    assert r"mine $\frac$ &lt;b&gt;" in base64.b64decode(first).decode()


def test_a_set_without_answers_is_reported_too(tmp_path: Path) -> None:
    files = tuple(image(tmp_path / f"{i}.jpg", i) for i in range(4))
    empty = Dataset("nothing", files[:2], files[2:], (np.zeros(0, np.int64),) * 2, "none")
    outcome = run(empty, [Contender(fake)], examples=0)
    assert "nothing" in as_html([outcome.evaluation], {})


def test_examples_show_right_and_wrong_and_the_papers_figures(outcome: Outcome) -> None:
    assert [e.right for e in outcome.examples] == [True, True, True, None, None]
    assert "ORB" in outcome.examples[-1].images[0].caption
    assert "ORB" in outcome.examples[-2].images[0].caption


def test_images_that_cannot_be_decoded_do_not_end_a_run(tmp_path: Path) -> None:
    files = {(f, i): image(tmp_path / f / f"{i}.jpg", i) for f in "dq" for i in range(24)}
    database, queries = (tuple(files[f, i] for i in range(24)) for f in "dq")
    database[3].write_bytes(b"junk")
    queries[7].write_bytes(queries[7].read_bytes()[:100])
    dataset = Dataset("walk", database, queries, tuple(np.array([i]) for i in range(24)), "same frame")
    wrong = Contender(lambda _: nullcontext(FakeRetriever(lambda a, b: abs(a - b))))
    found = run(dataset, [wrong], [TinyImage(), RandomOrder()], examples=24)
    tiny, chance = found.evaluation.methods[-2:]
    assert [number for number, first in enumerate(tiny.first) if first != 1] == [3, 7]
    assert (tiny.refused, chance.refused) == ({"undecodable-picture": 2}, {})
    assert "tiny image: refused 2 x undecodable-picture" in as_text(found.evaluation)
    page = as_html([found.evaluation], {"walk": found.examples})
    assert "tiny image refused 2 x undecodable-picture." in page
    assert "a right answer 3.jpg, which cannot be decoded" in page


def test_images_that_are_ranked_again_are_told_of_once(tmp_path: Path) -> None:
    files = [image(tmp_path / f"{i}.jpg", i) for i in range(10)]
    files[7].write_bytes(b"junk")
    told: list[tuple[int, int]] = []
    dataset = Dataset("walk", tuple(files), tuple(files[:1]), (np.array([0]),), "same frame")
    run(dataset, [], [TinyImage()], progress=lambda _, done, total: told.append((done, total)))
    assert told == [(done, 11) for done in range(1, 11)]


def test_the_command_writes_its_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for folder in ("database", "query"):
        for i in range(25):
            image(tmp_path / "set" / folder / f"{i}.png", i)
    given = ["aligned", "--root", str(tmp_path / "set"), "--no-service", "--out", str(tmp_path / "out")]
    assert main([*given, "--baselines", "random,tiny", "--tolerance", "0"]) == 0
    assert "tiny image" in capsys.readouterr().out
    [data] = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert data["methods"][1]["recall"][0]["value"] == 1
    assert (tmp_path / "out" / "report.html").read_text().startswith("<!doctype html>")
    assert (tmp_path / "out" / "evaluation.md").read_text().startswith("| set |")


def test_truth_alone_needs_no_method(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for folder in ("database", "query"):
        for i in range(5):
            image(tmp_path / folder / f"{i}.png", i)
    assert main(["aligned", "--root", str(tmp_path), "--truth-only"]) == 0
    shown = capsys.readouterr().out
    assert "(chance)" in shown
    assert "suspicious" in shown  # five images, five of them right with +-2


def test_a_wrong_folder_is_explained_with_exit_code_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["kitti", "--root", str(tmp_path)]) == 2
    assert "Expected:" in capsys.readouterr().err
    (tmp_path / "d").mkdir()
    assert main(["pairs", "--root", str(tmp_path), "--url", "http://127.0.0.1:1"]) == 2
