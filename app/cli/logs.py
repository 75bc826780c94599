"""Log lines as text or JSON: events with fields, never image bytes."""

import json
import logging
import sys
from datetime import UTC, datetime
from typing import Literal

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
        return json.dumps(line, default=str, ensure_ascii=False)


class TextLines(logging.Formatter):
    """A line of text; of an event's fields, only `ms` is shown."""

    def __init__(self) -> None:
        super().__init__("%(asctime)s %(levelname)-7s %(message)s", "%Y-%m-%d %H:%M:%S")

    def format(self, record: logging.LogRecord) -> str:
        """The record as text."""
        text = super().format(record)
        ms = getattr(record, "ms", None)
        return text if ms is None else f"{text} {ms:g} ms"


class _NoSetupTraceback(logging.Filter):
    """Drops uvicorn's traceback of a SetupError at start-up: the command line prints the reason."""

    def filter(self, record: logging.LogRecord) -> bool:
        return "SetupError" not in record.getMessage() and "Application startup failed" not in record.getMessage()


def configure(form: Literal["text", "json"]) -> None:
    """Send the lines of all loggers to stderr, as text or JSON."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLines() if form == "json" else TextLines())
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    for talkative in ("alembic", "faiss", "httpx"):
        logging.getLogger(talkative).setLevel(logging.WARNING)
    # The command line itself reports starting and stopping.
    logging.getLogger("uvicorn.error").setLevel(logging.WARNING)
    logging.getLogger("uvicorn.error").addFilter(_NoSetupTraceback())
