"""What the node localize does, without ROS: images in, answers out, one query at a time."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from revisit_client import Revisit
from revisit_client.wire import QueryAnswer

from revisit_ros.caller import Caller
from revisit_ros.health import Link, Report, report, trouble_of
from revisit_ros.images import Shot
from revisit_ros.pacing import Pace, Waiting
from revisit_ros.pose import Guess


@dataclass(frozen=True)
class Query:
    """One query."""

    shot: Shot
    guess: Guess | None


@dataclass(frozen=True)
class Answered:
    """An answer, and the image that it is to."""

    shot: Shot
    answer: QueryAnswer


class Localizer:
    """Its methods are called in one thread, the executor's, and never wait.

    Parameters
    ----------
    revisit : Revisit
        With a time limit and no patience: what is tried again is decided here.
    values : dict
        `settings.LOCALIZE`.
    wake : callable
        Called in another thread when there is something for `answers`.
    clock : callable
        Seconds, never going back.
    """

    def __init__(
        self, revisit: Revisit, values: dict[str, Any], wake: Callable[[], None], clock: Callable[[], float]
    ) -> None:
        self._revisit, self._values, self._clock = revisit, values, clock
        self._pace = Pace(values["rate"])
        self._waiting: Waiting[Shot] = Waiting(1)
        self._link = Link()
        self._caller: Caller[Query, QueryAnswer] = Caller(self._ask, wake, clock)
        self._asking = False
        self._guess: Guess | None = None
        self._started = clock()
        self._last_image: float | None = None
        self._last_s: float | None = None
        self._last_answer: QueryAnswer | None = None
        self._counts: Counter[str] = Counter()
        self.note = ""
        """What the node would do better with; told in /diagnostics."""
        self.published = 0

    def image(self, shot: Shot) -> None:
        """An image arrived: query with it, keep it as the next one, or leave it."""
        self._last_image = shot.arrived
        self._counts["images_received"] += 1
        if self._link.allows(shot.arrived) and self._pace.due(shot.arrived):
            self._waiting.put(shot)
            self._go_on(shot.arrived)
        else:
            self._counts["images_not_due"] += 1

    def trigger(self) -> tuple[bool, str]:
        """Query with the next image, whatever the rate. Whether that can be hoped for, and why not."""
        self._pace.triggered = True
        told = self.report()
        if told.values["state"] in ("working", "image refused"):
            return True, "the next image is queried with; a pose is published if it matches"
        return False, f"{told.message}; {told.values['remedy']}"

    def guess(self, guess: Guess | None) -> None:
        """Where to search from now on; None: everywhere."""
        self._guess = guess

    def answers(self) -> list[Answered]:
        """All answers since the last time; begins the next query."""
        found = []
        now = self._clock()
        for outcome in self._caller.outcomes():
            self._asking = False
            self._last_s = outcome.seconds
            if outcome.answer is not None:
                self._link.succeeded()
                self._counts[outcome.answer.status] += 1
                self._last_answer = outcome.answer
                found.append(Answered(outcome.job.shot, outcome.answer))
            elif outcome.error is not None:
                self._link.failed(trouble_of(outcome.error), now)
                self._counts["queries_failed"] += 1
        self._go_on(now)
        return found

    def report(self) -> Report:
        """For /diagnostics."""
        answer = self._last_answer
        counts = ("images_received", "images_not_due", "matched", "ambiguous", "no_match", "queries_failed")
        values = {name: str(self._counts[name]) for name in counts}
        values |= {"images_dropped": str(self._counts["images_too_old"] + self._waiting.dropped)}
        values |= {"num_published_poses": str(self.published), "map": self._values["map"], "url": self._revisit.url}
        if self._last_s is not None:
            values["localization_execution_time"] = f"{self._last_s:.3f}"
        if answer is not None:
            place = answer.places[0].place if answer.places else None
            values |= {"last_status": answer.status, "last_place": place or "", "last_reason": answer.reason.code}
            values |= {"last_confidence": f"{answer.confidence:.3f}"}
        return report(
            self._link,
            self._clock(),
            last_image=self._last_image,
            started=self._started,
            silence_s=self._values["silence"],
            topic=self._values["topic"],
            doing="waits for the first answer" if answer is None else f"last answer: {answer.status}",
            note=self.note,
            values=values,
        )

    def close(self) -> None:
        """Stop, with the query that runs, if it does not hang."""
        self._caller.close(1.0)

    def _go_on(self, now: float) -> None:
        """Begin a query with the image that waits."""
        if self._asking or not self._link.allows(now):
            return
        shot = self._waiting.take()
        if shot is None:
            return
        if now - shot.arrived > self._values["max_age"]:
            self._counts["images_too_old"] += 1
            return
        self._asking = True
        self._pace.take(now)
        self._caller.start(Query(shot, self._guess if self._values["use_initial_guess"] else None))

    def _ask(self, query: Query) -> QueryAnswer:
        """In the caller's thread."""
        guess = query.guess
        return self._revisit.query(
            query.shot.read(),
            map=self._values["map"],
            precision=self._values["precision"] or None,
            zoom=None if self._values["zoom"] == 1 else self._values["zoom"],
            drive=self._values["drive"] or None,
            exclude_last=self._values["exclude_last"] or None,
            near=None if guess is None else (guess.x, guess.y, guess.radius_m),
            geographic=None if guess is None else False,
        )
