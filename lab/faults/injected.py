"""Faults inside a process under test, on order: a clock that jumps."""

import threading
import time
from datetime import UTC, datetime
from multiprocessing.connection import Connection

import time_machine


def obey(orders: Connection) -> None:
    """Obey orders in a thread, for as long as the process lives.

    Parameters
    ----------
    orders : Connection
        Brings the seconds by which the clock shall be wrong, 0 for the true time, and takes back what was set.
    """
    threading.Thread(target=_obey, args=(orders,), name="faults", daemon=True).start()


def set_clock(orders: Connection, offset_s: float) -> None:
    """Let the process of the other end have a clock that is wrong by `offset_s`; returns once it has."""
    orders.send(offset_s)
    if orders.recv() != offset_s:
        raise ValueError("the process answered to another order")


def _obey(orders: Connection) -> None:
    # The true time, whatever the clock was set to: no clock that jumps is read twice.
    began, since = datetime.now(UTC).timestamp(), time.monotonic()
    wrong: time_machine.travel | None = None
    while True:
        try:
            offset_s = orders.recv()
        except (EOFError, OSError):  # who gives the orders has gone
            return
        if wrong is not None:
            wrong.stop()
            wrong = None
        if offset_s:
            # `time.monotonic` stays as it is: that is what a clock that is set does to a system.
            wrong = time_machine.travel(began + time.monotonic() - since + offset_s, tick=True)
            wrong.start()
        orders.send(offset_s)
