"""Waits for a view to be described without occupying a thread."""

import asyncio
import time

from schemas.records import ViewRecord
from worker.service.settlements import LOOK_AGAIN_S, Settlements


async def settled(settlements: Settlements, view_id: str, until: float) -> ViewRecord:
    """The view once it is ready or failed, or as it is when waiting is in vain or at the moment `until`.

    Parameters
    ----------
    settlements : Settlements
    view_id : str
    until : float
        A reading of `time.monotonic`; several images of one request share it.

    Raises
    ------
    NotFound
        The view was deleted meanwhile.
    """
    loop = asyncio.get_running_loop()
    event = asyncio.Event()

    def wake() -> None:  # in another thread
        if not loop.is_closed():
            loop.call_soon_threadsafe(event.set)

    with settlements.subscribed(view_id, wake):
        while True:
            vain = settlements.in_vain
            record = await asyncio.to_thread(settlements.look, view_id)
            left = until - time.monotonic()
            if record.state != "pending" or left <= 0 or vain:
                return record
            try:
                await asyncio.wait_for(event.wait(), min(LOOK_AGAIN_S, left))
            except TimeoutError:
                continue
            event.clear()
