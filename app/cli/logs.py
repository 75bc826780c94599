"""Log lines as text or JSON: events with fields, never image bytes."""

import json
import logging
import sys
from datetime import UTC, datetime
from typing import Literal

from schemas.log_context import fields

_USUAL = frozenset(vars(logging.LogRecord("", 0, "", 0, "", (), None))) | {"message", "asctime", "color_message"}


class JsonLines(logging.Formatter):
    """One JSON object a line, with all fields of an event."""

    def format(self, record: logging.LogRecord) -> str:
        """The record as JSON."""
        line: dict[str, object] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        line |= {name: value for name, value in vars(record).items() if name not in _USUAL}
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str, ensure_ascii=False).translate(_ESCAPED)


_SHOWN = ("request_id", "trace_id", "job_id", "view_id", "job_ids", "view_ids", "problem", "slow")
_CONTROL = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160), 0x2028, 0x2029)}
_ESCAPED = {code: f"\\u{code:04x}" for code in _CONTROL}
"""The same in JSON, of which `json` leaves some as they are: terminals obey them, and programs end lines at them."""


class TextLines(logging.Formatter):
    """A line of text with the fields that find it again; a traceback follows on lines of its own."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)-7s %(message)s", "%Y-%m-%d %H:%M:%S")

    def format(self, record: logging.LogRecord) -> str:
        """The record as text."""
        text = super().format(record)
        line, newline, traceback = text, "", ""
        if record.exc_info:  # formatted, it is the last part of the text
            traceback = text[len(self.formatMessage(record)) + 1 :]
            line, newline = self.formatMessage(record), "\n"
        shown = [f"{name}={getattr(record, name)}" for name in _SHOWN if hasattr(record, name)]
        # A path may hold line breaks: they must not look like lines of ours.
        took = [f"{record.ms:g} ms"] if hasattr(record, "ms") else []
        return " ".join([line, *took, *shown]).translate(_CONTROL) + newline + traceback


class _NoSetupTraceback(logging.Filter):
    """Drops uvicorn's traceback of a SetupError at start-up: the command line prints the reason."""

    def filter(self, record: logging.LogRecord) -> bool:
        return "SetupError" not in record.getMessage() and "Application startup failed" not in record.getMessage()


class _WithContext(logging.Filter):
    """Gives each record the fields that are bound where it is written, such as the request's id."""

    def filter(self, record: logging.LogRecord) -> bool:
        for name, value in fields().items():
            if not hasattr(record, name):
                setattr(record, name, value)
        return True


def configure(form: Literal["text", "json"], level: str = "info") -> None:
    """Send the lines of all loggers to stderr, as text or JSON, from a level on; of libraries none of the level debug.

    Those may say whatever was sent: Pillow writes each field of a photo's EXIF.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines() if form == "json" else TextLines())
    handler.addFilter(_WithContext())
    logging.basicConfig(level=max(getattr(logging, level.upper()), logging.INFO), handlers=[handler], force=True)
    logging.getLogger("revisit").setLevel(level.upper())
    for talkative in ("alembic", "boto3", "botocore", "faiss", "httpx"):
        logging.getLogger(talkative).setLevel(logging.WARNING)
    # The command line itself reports starting and stopping.
    logging.getLogger("uvicorn.error").setLevel(logging.WARNING)
    logging.getLogger("uvicorn.error").addFilter(_NoSetupTraceback())
