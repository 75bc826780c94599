"""Notices among the processes of one PostgreSQL database (LISTEN and NOTIFY): there is work, a view is settled.

A notice saves its receiver the wait until it looks again, and nothing else: whoever misses one finds the same in the
database when it polls. So a lost connection costs time and loses nothing.
"""

import logging
import threading
from collections.abc import Callable

import sqlalchemy as sa

from worker.storage.peers import SCHEMA

log = logging.getLogger("revisit")

WORK = "work"
NOTHING = ""

LISTENS_S = 1.0
"""Seconds after which a listener looks whether it should end."""

AGAIN_S = 5.0
"""Seconds after a failure before the connection is made anew."""

MOST_BYTES = 7000
"""Of one notice: PostgreSQL takes 8,000."""


class Notices:
    """Sends notices in a thread of its own, and receives those of others in a second one.

    Parameters
    ----------
    engine : Engine
        Of PostgreSQL. Each of the two threads keeps a connection.
    """

    def __init__(self, engine: sa.Engine) -> None:
        self._engine = engine
        self._lock = threading.Lock()
        self._work = False
        self._settled: list[str] = []
        self._something = threading.Event()
        self._ended = threading.Event()
        self._listening = threading.Event()
        self._threads: list[threading.Thread] = []

    @property
    def listening(self) -> bool:
        """Whether notices of others arrive now."""
        return self._listening.is_set()

    def start(self, *, on_work: Callable[[], None] | None, on_settled: Callable[[str], None] | None) -> None:
        """Begin; the functions are called in a thread of this object, None where a process has no use for them."""

        def receive(text: str) -> None:
            if text == WORK:
                if on_work is not None:
                    on_work()
            elif text != NOTHING and on_settled is not None:
                for view_id in text.split(","):
                    on_settled(view_id)

        def run(work: Callable[[sa.Connection, str], None]) -> None:
            while not self._ended.is_set():
                self._connected(work)
                self._ended.wait(AGAIN_S)

        loops = {
            "revisit-telling": self._send,
            "revisit-listening": lambda connection, channel: self._listen(connection, channel, receive),
        }
        self._threads = [
            threading.Thread(target=run, args=(work,), name=name, daemon=True) for name, work in loops.items()
        ]
        for thread in self._threads:
            thread.start()

    def work(self) -> None:
        """Tell that a job was queued; returns at once."""
        with self._lock:
            self._work = True
        self._something.set()

    def settled(self, view_id: str) -> None:
        """Tell that a view was described or failed; returns at once."""
        with self._lock:
            self._settled.append(view_id)
        self._something.set()

    def stop(self) -> None:
        """Send what there is, and end."""
        self._ended.set()
        self._something.set()
        for thread in self._threads:
            thread.join(AGAIN_S)

    def _connected(self, work: Callable[[sa.Connection, str], None]) -> None:
        """Do something with a connection and the name of the channel, until it fails or all ends."""
        try:
            with self._engine.connect() as connection:
                connection = connection.execution_options(isolation_level="AUTOCOMMIT")
                channel = f"revisit_{connection.scalar(sa.text(f'SELECT {SCHEMA}'))}"
                try:
                    work(connection, channel)
                finally:
                    connection.invalidate()  # not into the pool: it listens
        except (sa.exc.SQLAlchemyError, OSError) as error:
            if not self._ended.is_set():
                reason = getattr(error, "orig", None) or error
                log.info("notices between processes wait for the database: %s; work is found by polling", reason)

    def _send(self, connection: sa.Connection, channel: str) -> None:
        while True:
            self._something.wait()
            self._something.clear()
            with self._lock:
                work, settled = self._work, self._settled
                self._work, self._settled = False, []
            ended = self._ended.is_set()
            texts = [WORK] * work + _joined(settled) + [NOTHING] * ended  # its own listener hears that it may end
            for text in texts:
                told = sa.text("SELECT pg_notify(:channel, :text)")
                connection.execute(told, {"channel": channel, "text": text})
            if ended:
                return

    def _listen(self, connection: sa.Connection, channel: str, receive: Callable[[str], None]) -> None:
        connection.execute(sa.text(f'LISTEN "{channel}"'))
        driver = connection.connection.driver_connection
        assert driver is not None
        self._listening.set()
        try:
            while not self._ended.is_set():
                for notice in driver.notifies(timeout=LISTENS_S):
                    receive(notice.payload)
                    if self._ended.is_set():
                        return
        except Exception as error:  # of psycopg, past SQLAlchemy
            raise sa.exc.DBAPIError("LISTEN", None, error) from error
        finally:
            self._listening.clear()


def _joined(view_ids: list[str]) -> list[str]:
    """Texts of notices with all of these ids."""
    texts: list[str] = []
    for view_id in view_ids:
        if texts and len(texts[-1]) + len(view_id) < MOST_BYTES:
            texts[-1] += f",{view_id}"
        else:
            texts.append(view_id)
    return texts
