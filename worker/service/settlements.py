"""Waiting until a view is settled (described or failed), by whichever process."""

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from schemas.errors import RevisitError
from schemas.records import ViewRecord
from worker.service.ports import Views

LOOK_AGAIN_S = 0.25
"""Seconds between looks at the store: a worker in another process cannot notify this one."""

Notify = Callable[[], None]


class Settlements:
    """Wakes callers that wait for a view when the worker of this process has settled it, or when waiting is in vain.

    Parameters
    ----------
    views : Views
    encoder_away : function
        Whether descriptions wait for an encoder that is away.
    """

    def __init__(self, views: Views, encoder_away: Callable[[], bool] = lambda: False) -> None:
        self._views, self._encoder_away = views, encoder_away
        self._waiting: dict[str, set[Notify]] = defaultdict(set)
        self._lock = threading.Lock()
        self._given_up = False
        self._trouble: RevisitError | None = None

    @property
    def trouble(self) -> RevisitError | None:
        """Why descriptions cannot be stored now, or None."""
        return self._trouble

    @property
    def in_vain(self) -> bool:
        """Whether nobody should wait: the service stops, the encoder is away, or descriptions cannot be stored."""
        return self._given_up or self._trouble is not None or self._encoder_away()

    def give_up(self) -> None:
        """Wake all callers, now and from now on: the service stops, and their views are described later."""
        self._given_up = True
        self._wake_all()

    def refuse(self, trouble: RevisitError | None) -> None:
        """Wake all callers because descriptions cannot be stored; None when they can again."""
        self._trouble = trouble
        if trouble is not None:
            self._wake_all()

    def notify(self, view_id: str) -> None:
        """Wake the callers that wait for a view; called in the worker's thread."""
        with self._lock:
            waiting = list(self._waiting.get(view_id, ()))
        for call in waiting:
            call()

    def _wake_all(self) -> None:
        with self._lock:
            waiting = [call for calls in self._waiting.values() for call in calls]
        for call in waiting:
            call()

    @contextmanager
    def subscribed(self, view_id: str, call: Notify) -> Iterator[None]:
        """While the block runs, `call` is called in another thread when the view is settled or waiting is in vain."""
        with self._lock:
            self._waiting[view_id].add(call)
        try:
            yield
        finally:
            with self._lock:
                self._waiting[view_id].discard(call)
                if not self._waiting[view_id]:
                    del self._waiting[view_id]

    def look(self, view_id: str) -> ViewRecord:
        """The current state of a view; raises NotFound."""
        return self._views.get(view_id)

    def wait(self, view_id: str, patience_s: float) -> ViewRecord:
        """The view once it is ready or failed, or as it is after `patience_s` seconds; raises NotFound."""
        event = threading.Event()
        until = time.monotonic() + patience_s
        with self.subscribed(view_id, event.set):
            while True:
                vain = self.in_vain
                record = self.look(view_id)
                left = until - time.monotonic()
                if record.state != "pending" or left <= 0 or vain:
                    return record
                event.wait(min(LOOK_AGAIN_S, left))
                event.clear()
