"""What queries found, as events: told to others by webhooks and MQTT."""

from collections.abc import Callable
from datetime import datetime
from typing import Any, Literal, Protocol

from schemas.wire import QueryAnswer, rfc3339

Outcome = Literal["delivered", "refused", "given_up", "dropped"]

WAITING = 1000
"""Events that wait at most, of each kind of teller."""

PATIENCE_S = 3.0
"""Seconds that a stop waits for events to be taken."""


class Teller(Protocol):
    """Tells others what queries found, without delaying them."""

    name: str
    """As its metric names it."""

    def start(self) -> None:
        """Begin, when the service does."""
        ...

    def tell(self, answer: QueryAnswer) -> None:
        """Tell what a query found, if such events are wanted; returns at once."""
        ...

    def on_outcome(self, count: Callable[[Outcome], None]) -> None:
        """Have `count` called with what becomes of each event."""
        ...

    def close(self) -> None:
        """Tell what waits, for at most `PATIENCE_S`, and end."""
        ...


def kind_of(answer: QueryAnswer) -> str:
    """``matched``, ``no_match``, ``look-alike``, or ``ambiguous`` for another reason."""
    return "look-alike" if answer.reason.code == "look-alike" else answer.status


def event(kind: str, answer: QueryAnswer, now: datetime) -> dict[str, Any]:
    """The body of an event: no image, and of views their ids alone."""
    first = answer.places[0] if answer.places else None
    rival = None if answer.reason.rival is None else answer.reason.rival.view
    where = None if answer.estimate is None else answer.estimate.model_dump(mode="json", exclude={"views"})
    return {
        "type": f"query.{kind}",
        "timestamp": rfc3339(now),
        "data": {
            "query": answer.query.id,
            "map": answer.map,
            "status": answer.status,
            "reason": answer.reason.code,
            "confidence": answer.confidence,
            "place": None if first is None else first.place,
            "view": answer.matches[0].view.id if answer.matches else None,
            "estimate": where,
            "rival": None if rival is None else {"map": rival.map, "place": rival.place, "view": rival.id},
        },
    }
