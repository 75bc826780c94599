"""Tables, sizes, progress, log lines."""

import io
import json
import logging

import pytest

from app.cli import console, logs


def test_a_table_puts_numbers_to_the_right() -> None:
    text = console.table(("name", "score"), [("a", 0.5), ("long", None)])

    assert text.splitlines() == ["name  score", "----  -----", "a     0.500", "long      -"]


def test_an_empty_table_has_its_heads() -> None:
    assert console.table(("a", "b"), []).splitlines() == ["a  b", "-  -"]


@pytest.mark.parametrize(
    ("count", "text"), [(0, "0 B"), (999, "999 B"), (1500, "1.5 kB"), (2_000_000, "2.0 MB"), (5e15, "5000.0 TB")]
)
def test_sizes(count: float, text: str) -> None:
    assert console.size(count) == text


def test_progress_without_a_terminal_says_how_it_ended() -> None:
    stream = io.StringIO()
    progress = console.Progress(2, "pictures", stream)
    progress.step()
    progress.step()
    progress.end()

    assert stream.getvalue().splitlines()[-1].startswith("2/2 pictures")


def test_json_lines_carry_the_fields_of_an_event() -> None:
    record = logging.makeLogRecord({"name": "revisit", "levelname": "INFO", "msg": "done", "job": "j1", "ms": 5})

    line = json.loads(logs.JsonLines().format(record))

    assert (line["message"], line["job"], line["ms"], line["level"]) == ("done", "j1", 5, "info")
    assert logs.TextLines().format(record).endswith("done 5 ms")
