"""Waiting until a view is settled (described or failed), by whichever process."""

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from schemas.records import ViewRecord
from worker.service.ports import Views

LOOK_AGAIN_S = 0.25
"""Seconds between looks at the store: a worker in another process cannot notify this one."""

Notify = Callable[[], None]


class Settlements:
    """Wakes callers that wait for a view when the worker of this process has settled it.

    Parameters
    ----------
    views : Views
    """

    def __init__(self, views: Views) -> None:
        self._views = views
        self._waiting: dict[str, set[Notify]] = defaultdict(set)
        self._lock = threading.Lock()

    def notify(self, view_id: str) -> None:
        """Wake the callers that wait for a view; called in the worker's thread."""
        with self._lock:
            waiting = list(self._waiting.get(view_id, ()))
        for call in waiting:
            call()

    @contextmanager
    def subscribed(self, view_id: str, call: Notify) -> Iterator[None]:
        """While the block runs, `call` is called in the worker's thread when the view is settled."""
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
                record = self.look(view_id)
                left = until - time.monotonic()
                if record.state != "pending" or left <= 0:
                    return record
                event.wait(min(LOOK_AGAIN_S, left))
                event.clear()
