"""When a view is described, or given up, whichever process does it."""

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from schemas.records import ViewRecord
from worker.service.ports import Views

LOOK_AGAIN_S = 0.25
"""A worker in another process cannot call back, so the store is looked at again this often."""

Notify = Callable[[], None]


class Settlements:
    """Tells those who wait for a view as soon as the worker in this process has settled it.

    Parameters
    ----------
    views : Views
    """

    def __init__(self, views: Views) -> None:
        self._views = views
        self._waiting: dict[str, set[Notify]] = defaultdict(set)
        self._lock = threading.Lock()

    def notify(self, view_id: str) -> None:
        """A view was settled; called in the worker's thread."""
        with self._lock:
            waiting = list(self._waiting.get(view_id, ()))
        for call in waiting:
            call()

    @contextmanager
    def subscribed(self, view_id: str, call: Notify) -> Iterator[None]:
        """A block during which `call` is called, in the worker's thread, when the view is settled."""
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
        """The view as it is; raises NotFound."""
        return self._views.get(view_id)

    def wait(self, view_id: str, patience_s: float) -> ViewRecord:
        """The view once it is ready or failed, or as it is when patience runs out; raises NotFound."""
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
