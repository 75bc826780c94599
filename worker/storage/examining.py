"""Examines a data folder, read only: what is wrong, where, and what to do.

Nothing that lies in the folder makes an examination raise: what cannot be read is a finding too.
"""

import os
import sqlite3
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import sqlalchemy as sa

from schemas.errors import RevisitError
from worker.storage import dialect, error_codes, migrating, wal
from worker.storage.examining_images import image_findings
from worker.storage.examining_objects import last_sign, object_findings
from worker.storage.examining_rows import row_findings
from worker.storage.finding import BACKUP, REPAIR, Finding, Mend
from worker.storage.image_store import needed_among
from worker.storage.known_images import KnownImages
from worker.storage.ownership import id_of, is_new
from worker.storage.signs import Sign, is_elsewhere
from worker.storage.tables import METADATA

STOP = f"stop the service, then {REPAIR}; if that cannot, {BACKUP}"

ELSEWHERE = "is the disk read-only? Copy the data folder to one that can be written, and examine the copy"

MOST_LINES = 20
"""Lines of SQLite's own check that are reported."""


def examine(url: str, data: Path, *, running: bool = False, images: str | None = None) -> Iterator[Finding]:
    """All findings of a data folder.

    Parameters
    ----------
    url : str
        SQLAlchemy URL of the database.
    data : Path
        Data folder.
    running : bool
        Whether a service uses the folder: its log and its unfinished files change all the time, and are left out.
    images : str or None
        ``s3://bucket/prefix`` where the images do not lie in the folder.
    """
    if not data.is_dir() or not os.access(data, os.R_OK | os.X_OK):
        yield Finding(str(data), "is no folder that can be read", "see REVISIT_DATA, or restore a backup")
        return
    known = KnownImages(running)
    sign = None if images is None else last_sign(images)  # before the count that it is compared with
    path = database_file(url)
    if path is not None and (blocked := file_finding(path)) is not None:
        yield blocked
    else:
        if path is not None and not running:
            yield from _log_findings(path)
        yield from _database_findings(url, sign, known)
    if running and known.owners is not None:
        # Of a service that runs some views are deleted after they were read, and their images with them.
        known.needed = partial(_needed_now, url)
    yield from image_findings(data / "pictures", known) if images is None else object_findings(images, known)


def _database_findings(url: str, sign: Sign | None, known: KnownImages) -> Iterator[Finding]:
    """Findings of the database; fills `known`."""
    with dialect.reader(url) as engine:
        try:
            damage = list(structure_findings(engine))
            yield from damage
            if any(finding.where == "database" for finding in damage):
                return
            tables = list(_table_findings(engine))
            yield from tables
            if tables:
                return
            known.owners = {}
            with engine.connect() as connection:
                known.own, known.elsewhere = id_of(connection), is_elsewhere(sign, connection)
                known.new = is_new(connection)
            yield from row_findings(engine, known.owners)
        except (sa.exc.SQLAlchemyError, sqlite3.Error, RevisitError, UnicodeError) as error:
            yield Finding("database", f"cannot be read on ({getattr(error, 'orig', error)})", f"{REPAIR}, or {BACKUP}")
            known.owners = None


def _needed_now(url: str, digests: list[str]) -> set[str]:
    try:
        with dialect.reader(url) as engine, engine.connect() as connection:
            return needed_among(connection, digests)
    except (sa.exc.SQLAlchemyError, sqlite3.Error):
        return set(digests)


def database_file(url: str) -> Path | None:
    """The file of a SQLite database; None for PostgreSQL."""
    parsed = sa.make_url(url)
    return Path(parsed.database) if parsed.get_backend_name() == "sqlite" and parsed.database else None


def file_finding(path: Path) -> Finding | None:
    """What keeps the file of a database from being opened at all, or None."""
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(16)
    except FileNotFoundError:
        return Finding(str(path), "is missing", BACKUP)
    except OSError as error:
        return Finding(str(path), f"cannot be read ({error.strerror})", "see its owner and its permissions")
    if size == 0:
        return Finding(str(path), "is empty", BACKUP)
    if head != b"SQLite format 3\0":
        return Finding(str(path), "does not begin as a database does", f"{REPAIR}, or {BACKUP}")
    return None


def _log_findings(path: Path) -> Iterator[Finding]:
    log = path.with_name(path.name + "-wal")
    try:
        fault = wal.fault(log)
    except OSError as error:
        fault = f"cannot be read ({error.strerror})"
    if fault is not None:
        yield Finding(
            str(log), fault, f"what was written last may be lost, if not the power failed just then: {BACKUP}; {REPAIR}"
        )


def structure_findings(engine: sa.Engine) -> Iterator[Finding]:
    """What the database's own checks say; one with `where` "database" means that its rows may not be read."""
    if engine.dialect.name != "sqlite":
        return
    try:
        with engine.connect() as connection:
            lines = [str(row[0]) for row in connection.exec_driver_sql(f"PRAGMA integrity_check({MOST_LINES})")]
            broken = list(connection.exec_driver_sql("PRAGMA foreign_key_check")) if lines == ["ok"] else []
    except (sa.exc.SQLAlchemyError, sqlite3.Error, UnicodeError) as error:
        if error_codes.is_unopened(error):
            yield Finding("database", f"cannot be opened here ({getattr(error, 'orig', error)})", ELSEWHERE)
            return
        yield Finding(
            "database",
            f"is damaged ({getattr(error, 'orig', error)})",
            f"stop the service, then {REPAIR}; if that cannot, {BACKUP}",
        )
        return
    for line in lines if lines != ["ok"] else []:
        yield Finding("database", " ".join(line.split()), STOP)
    for table, rowid, parent, _ in broken:
        yield Finding(
            f"row {rowid} of {table}",
            f"belongs to a row of {parent} that is not there",
            REPAIR,
            _deletion(str(table), int(rowid)),
        )


def _deletion(table: str, rowid: int) -> Mend:
    def mend(connection: sa.Connection) -> str:
        connection.exec_driver_sql(f'DELETE FROM "{table}" WHERE rowid = {rowid}')
        return "removed"

    return mend


def _table_findings(engine: sa.Engine) -> Iterator[Finding]:
    with engine.connect() as connection:
        found = migrating.current(connection)
        if found != migrating.newest():
            newer = found is not None and found not in migrating.known()
            remedy = "run the newer version" if newer else "./revisit migrate"
            yield Finding("tables", f"are at {found}, this version needs {migrating.newest()}", remedy)
            return
        for name in sorted(METADATA.tables.keys() - set(sa.inspect(connection).get_table_names())):
            yield Finding("database", f"the table {name} is missing", f"{REPAIR}, or {BACKUP}")
