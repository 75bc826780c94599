"""Tables, sizes, progress, log lines."""

import io
import json
import logging
import re
import sys

import pytest

from app.cli import logs, output


def test_a_table_puts_numbers_to_the_right() -> None:
    text = output.table(("name", "score"), [("a", 0.5), ("long", None)])

    assert text.splitlines() == ["name  score", "----  -----", "a     0.500", "long      -"]


def test_an_empty_table_has_its_heads() -> None:
    assert output.table(("a", "b"), []).splitlines() == ["a  b", "-  -"]


@pytest.mark.parametrize(
    ("count", "text"), [(0, "0 B"), (999, "999 B"), (1500, "1.5 kB"), (2_000_000, "2.0 MB"), (5e15, "5000.0 TB")]
)
def test_sizes(count: float, text: str) -> None:
    assert output.size(count) == text


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_without_a_terminal_is_a_line_for_each_tenth(capsys: pytest.CaptureFixture[str]) -> None:
    with output.progress_bar(40, "images") as step:
        for number in range(40):
            step(f"{number}.jpg")

    out, err = capsys.readouterr()
    assert err.splitlines() == [f"{done}/40 images" for done in range(4, 41, 4)]
    assert out == ""


def test_progress_of_less_than_ten_ends_with_all_of_them(capsys: pytest.CaptureFixture[str]) -> None:
    with output.progress_bar(2, "images") as step:
        step("a.jpg")
        step("b.jpg")

    assert capsys.readouterr().err.splitlines()[-1] == "2/2 images"


def test_quiet_progress_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with output.progress_bar(1, "images", quiet=True) as step:
        step("a.jpg")

    assert capsys.readouterr() == ("", "")


def test_a_bar_on_a_terminal_leaves_results_and_the_cursor_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal, results = Terminal(), io.StringIO()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(sys, "stdout", results)
    monkeypatch.setenv("TERM", "xterm")

    def interrupted() -> None:
        with output.progress_bar(2, "images") as step:
            step("[a].jpg")
            output.show("a result")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()

    assert results.getvalue() == "a result\n"
    assert "1/2 images" in re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", terminal.getvalue())
    assert "[a].jpg" in terminal.getvalue()
    assert terminal.getvalue().rindex("\x1b[?25h") > terminal.getvalue().rindex("\x1b[?25l")  # shown after hidden


def test_json_lines_carry_the_fields_of_an_event() -> None:
    record = logging.makeLogRecord({"name": "revisit", "levelname": "INFO", "msg": "done", "job": "j1", "ms": 5})

    line = json.loads(logs.JsonLines().format(record))

    assert (line["message"], line["job"], line["ms"], line["level"]) == ("done", "j1", 5, "info")
    assert logs.TextLines().format(record).endswith("done 5 ms")


@pytest.mark.parametrize("encoding", ["ascii", "iso-8859-1", "utf-8"])
def test_results_come_through_whatever_letters_a_terminal_has(monkeypatch: pytest.MonkeyPatch, encoding: str) -> None:
    names = ["caf\u00e9", "\u6771\u4eac", "\U0001f6aa", "caf\udce9"]
    out = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(out, encoding))
    output.show_json(names)
    assert json.loads(out.getvalue().decode(encoding)) == names
    output.show(names[1])
    monkeypatch.setattr(sys, "stderr", io.TextIOWrapper(io.BytesIO(), encoding, errors="strict"))
    output.say(names[2])
