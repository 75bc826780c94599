"""Waiting until a view is described, whichever process describes it."""

import asyncio
import time
from collections import defaultdict

from schemas.ports import Store
from schemas.records import ViewRecord

LOOK_AGAIN_S = 0.25
"""A worker in another process cannot call back, so the store is asked again this often."""


class Waiter:
    """Wakes those who wait for a view as soon as the worker in this process has settled it.

    Parameters
    ----------
    store : Store
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._waiting: dict[str, set[asyncio.Event]] = defaultdict(set)
        self._loop: asyncio.AbstractEventLoop | None = None

    def notify(self, view_id: str) -> None:
        """A view was settled; called in the worker's thread."""
        loop = self._loop
        if loop is not None and not loop.is_closed():
            loop.call_soon_threadsafe(self._wake, view_id)

    def _wake(self, view_id: str) -> None:
        for event in self._waiting.get(view_id, ()):
            event.set()

    async def wait(self, view_id: str, patience_s: float) -> ViewRecord:
        """The view once it is ready or failed, or as it is when patience runs out.

        Raises
        ------
        NotFound
            It was deleted meanwhile.
        """
        self._loop = asyncio.get_running_loop()
        event = asyncio.Event()
        self._waiting[view_id].add(event)
        until = time.monotonic() + patience_s
        try:
            while True:
                record = await asyncio.to_thread(self._store.view, view_id)
                left = until - time.monotonic()
                if record.state != "pending" or left <= 0:
                    return record
                try:
                    await asyncio.wait_for(event.wait(), min(LOOK_AGAIN_S, left))
                except TimeoutError:
                    continue
                event.clear()
        finally:
            self._waiting[view_id].discard(event)
            if not self._waiting[view_id]:
                del self._waiting[view_id]
