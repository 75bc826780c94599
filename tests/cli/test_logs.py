"""Log lines: one event a line, with the fields that find it again."""

import json
import logging
import sys

from app.cli.logs import JsonLines, TextLines, _WithContext
from schemas.log_context import bound


def record(message: str, **fields: object) -> logging.LogRecord:
    made = logging.LogRecord("revisit.access", logging.INFO, "f.py", 1, message, (), None)
    made.__dict__.update(fields)
    _WithContext().filter(made)
    return made


def test_a_line_carries_what_is_bound_where_it_is_written() -> None:
    with bound(request_id="r1"), bound(job_id="j1"):
        line = json.loads(JsonLines().format(record("done", ms=3.5)))
    assert (line["request_id"], line["job_id"], line["ms"]) == ("r1", "j1", 3.5)
    assert "request_id" not in json.loads(JsonLines().format(record("outside")))


def test_a_field_of_the_event_itself_wins() -> None:
    with bound(view_id="bound"):
        assert "view_id=own" in TextLines().format(record("done", view_id="own"))


def test_a_line_break_in_a_path_does_not_forge_a_line() -> None:
    message = "GET /views/a\n2026-01-01 00:00:00 INFO    all is well\x1b[2J\x85\u2028\x9b31m 404"
    for form in (TextLines(), JsonLines()):
        text = form.format(record(message))
        assert len(text.splitlines()) == 1
        assert not {"\x1b", "\x9b"} & set(text)
    assert json.loads(text)["message"] == message


def test_a_traceback_follows_its_line_which_has_the_id() -> None:
    made = record("request failed", request_id="r2")
    try:
        raise ZeroDivisionError("for the log alone")
    except ZeroDivisionError:
        made.exc_info = sys.exc_info()
    first, *rest = TextLines().format(made).splitlines()
    assert "request failed" in first
    assert "request_id=r2" in first
    assert rest[0].startswith("Traceback")
    assert rest[-1] == "ZeroDivisionError: for the log alone"
