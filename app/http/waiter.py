"""Waits for a view to be described without occupying a thread."""

import asyncio
import time

from schemas.records import ViewRecord
from worker.service.settlements import LOOK_AGAIN_S, Settlements


class Waiter:
    """Waits for views, until the service drains.

    Parameters
    ----------
    settlements : Settlements
    """

    def __init__(self, settlements: Settlements) -> None:
        self._settlements = settlements
        self._waiting: set[asyncio.Event] = set()
        self._draining = False

    def drain(self) -> None:
        """Wake all that wait; nothing waits from now on. On the event loop."""
        self._draining = True
        for event in self._waiting:
            event.set()

    async def settled(self, view_id: str, patience_s: float) -> ViewRecord:
        """The view once it is ready or failed, or as it is after `patience_s` seconds or when the service drains.

        Raises
        ------
        NotFound
            The view was deleted meanwhile.
        """
        loop = asyncio.get_running_loop()
        event = asyncio.Event()

        def wake() -> None:  # in the worker's thread
            if not loop.is_closed():
                loop.call_soon_threadsafe(event.set)

        until = time.monotonic() + patience_s
        self._waiting.add(event)
        try:
            with self._settlements.subscribed(view_id, wake):
                while True:
                    record = await asyncio.to_thread(self._settlements.look, view_id)
                    left = until - time.monotonic()
                    if record.state != "pending" or left <= 0 or self._draining:
                        return record
                    try:
                        await asyncio.wait_for(event.wait(), min(LOOK_AGAIN_S, left))
                    except TimeoutError:
                        continue
                    event.clear()
        finally:
            self._waiting.discard(event)
