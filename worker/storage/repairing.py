"""Mends what an examination finds, as far as the content of the data folder allows.

Nobody may use the folder meanwhile: repair holds its locks. A database whose pages are damaged is copied row by row
into a new file; the old one is kept beside it. Then damaged rows are mended, removed where they are made again by
themselves, or set aside, and views without a description are queued to be described from their images.
"""

import os
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

import sqlalchemy as sa

from schemas.errors import RevisitError, SetupError
from worker.storage import dialect, migrating, wal
from worker.storage.database import Database
from worker.storage.examining import database_file, examine, file_finding, structure_findings
from worker.storage.examining_images import is_orphan
from worker.storage.examining_rows import scan
from worker.storage.finding import Finding
from worker.storage.image_store import open_images
from worker.storage.known_images import ORPHAN
from worker.storage.locks import USE, FolderLock, lock_for_serving
from worker.storage.tables import METADATA

ROUNDS = 5
"""Examinations at most: mending one row may show another."""

HEAD = b"SQLite format 3\0" + bytes([0x20, 0x00, 2, 2, 0, 64, 32, 32])
"""First bytes of every database of revisit: pages of 8192 bytes, write-ahead log."""

RESCUED = "rescued"
"""Folder for images whose views may be lost."""

UNREADABLE = (RevisitError, sa.exc.SQLAlchemyError, sqlite3.Error, UnicodeError)
"""What reading a damaged database raises; a message that quotes damaged text cannot be decoded itself."""


@contextmanager
def alone(data: Path) -> Iterator[None]:
    """Hold a data folder alone; raises SetupError when a service or a worker uses it."""
    serving = lock_for_serving(data, datetime.now(UTC))
    use = FolderLock(data / USE)
    try:
        if not use.acquire():
            raise SetupError(f"a worker or a command uses {data}; stop it first, then repair")
        yield
    finally:
        use.release()
        serving.release()


def is_served(data: Path) -> bool:
    """Whether a service or a worker uses a data folder."""
    try:
        with alone(data):
            return False
    except (SetupError, OSError):
        return True


def repair(url: str, data: Path, images: str | None = None) -> tuple[list[str], list[Finding]]:
    """Mend a data folder; returns what was done, a line each, and the findings that are left.

    Raises
    ------
    SetupError
        The folder is in use.
    """
    with alone(data):
        done: list[str] = []
        lost = _mend_file(url, done)
        for _ in range(ROUNDS):
            findings = list(examine(url, data, images=images))
            rescue = lost or any(finding.where.endswith("-wal") for finding in findings)
            if not _mend_findings(url, data, findings, done, rescue=rescue, images=images):
                break
            lost = rescue
        return done, list(examine(url, data, images=images))


def _mend_file(url: str, done: list[str]) -> bool:
    """Make the file of the database one that can be read; returns whether rows may have been lost."""
    path = database_file(url)
    if path is None or not path.exists():
        return False
    if not path.is_file():
        done.append(f"{path}: is no file; move it away and restore a backup")
        return False
    log = path.with_name(path.name + "-wal")
    lost = False
    try:
        if (fault := wal.fault(log)) is not None:
            kept = _beside(log)
            shutil.copyfile(log, kept)
            done.append(f"{log}: {fault}; commits before that were taken over, a copy is in {kept.name}")
            lost = True
        blocked = file_finding(path)
    except OSError as error:
        done.append(f"{path}: cannot be read ({error.strerror}); nothing was done")
        return False
    if lost and blocked is None:
        _take_over_log(url)
    if blocked is None and not _is_malformed(url):
        return lost
    if blocked is None and _reindexed(url):
        done.append(f"{path}: its indexes were built anew")
        return lost
    if blocked is None and (other := _other_revision(url)) is not None:
        done.append(
            f"{path}: is damaged, and its tables are at {other}, which only the version of revisit that made it can "
            "mend: nothing was done"
        )
        return lost
    if path.stat().st_size == 0:
        return lost
    if (told := _salvage(path)) is None:
        done.append(f"{path}: no row can be read any more; restore a backup, or move it away and enrol pictures/ again")
        return lost
    done.append(told)
    return True


def _take_over_log(url: str) -> None:
    """Write what can be read of the log to the database, and begin a new log."""
    with suppress(*UNREADABLE), closing(Database(url)) as database, database.engine.connect() as connection:
        connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")


def _is_malformed(url: str) -> bool:
    try:
        with dialect.reader(url) as engine:
            with engine.connect() as connection:
                names = set(sa.inspect(connection).get_table_names())
            found = any(finding.where == "database" for finding in structure_findings(engine))
        whole = not names or METADATA.tables.keys() <= names or _other_revision(url) is not None
        return found or not whole
    except UNREADABLE:
        return True


def _other_revision(url: str) -> str | None:
    """The revision of a database's tables if another version made them, with others than this one's; else None."""
    try:
        with dialect.reader(url) as engine, engine.connect() as connection:
            found = migrating.current(connection)
        return None if found == migrating.newest() else found
    except UNREADABLE:
        return None


def _reindexed(url: str) -> bool:
    """Whether the database is whole once its indexes are built anew."""
    try:
        with closing(Database(url)) as database, database.writing() as connection:
            connection.exec_driver_sql("REINDEX")
    except UNREADABLE:
        return False
    return not _is_malformed(url)


def _salvage(path: Path) -> str | None:
    """Copy all rows that can be read into a new file, which takes the old one's place; returns what to tell."""
    old, new = _beside(path), path.with_name(path.name + ".new")
    for leftover in (new, Path(f"{new}-wal"), Path(f"{new}-shm")):
        leftover.unlink(missing_ok=True)
    shutil.copyfile(path, old)
    log = path.with_name(path.name + "-wal")
    if log.exists():
        shutil.copyfile(log, f"{old}-wal")
    counts: dict[str, int] = {}
    for attempt in ("as it is", "with a new head"):
        if attempt != "as it is":
            with old.open("r+b") as file:
                file.write(HEAD)
        try:
            counts = _copy(old, new)
        except UNREADABLE:
            counts = {}
        if counts.get("maps"):
            break
    if not counts.get("maps"):
        new.unlink(missing_ok=True)
        return None
    log.unlink(missing_ok=True)
    path.with_name(path.name + "-shm").unlink(missing_ok=True)
    os.replace(new, path)
    some = ", ".join(f"{counts.get(name, 0)} {name}" for name in ("maps", "views", "descriptions"))
    return f"{path}: was damaged; what can be read was copied into a new file ({some}); {old.name} is the old one"


def _copy(old: Path, new: Path) -> dict[str, int]:
    counts: dict[str, int] = {}
    with closing(Database(f"sqlite:///{new}")) as target:
        migrating.create(target)
        with (
            dialect.reader(f"sqlite:///{old}", damaged=True) as source,
            source.connect() as reading,
            closing(sqlite3.connect(new)) as writing,
        ):
            writing.execute("PRAGMA foreign_keys=OFF")
            writing.execute("DELETE FROM clock")
            writing.execute("DELETE FROM installation")
            for table in METADATA.sorted_tables:
                counts[table.name] = _copy_table(reading, writing, table)
            writing.commit()
    return counts


def _copy_table(reading: sa.Connection, writing: sqlite3.Connection, table: sa.Table) -> int:
    """Rows as they are stored, with their checksums: what they hold is examined afterwards."""
    names = [column.name for column in table.columns]
    # Without the types: what is stored is copied, not what it would be read as.
    bare = sa.table(table.name, *(sa.column(name) for name in names))
    insert = f"INSERT OR IGNORE INTO {table.name} ({', '.join(names)}) VALUES ({', '.join('?' * len(names))})"
    count = 0
    for row in scan(reading, bare):
        if not isinstance(row, Finding):
            values = [_stored(value) for value in list(row)[: len(names)]]
            try:
                count += writing.execute(insert, values).rowcount
            except (sqlite3.IntegrityError, sqlite3.DataError, OverflowError):
                continue  # a NULL where none may be: nothing can be made of the row
    return count


def _stored(value: object) -> object:
    """A value that can be written: text that is not UTF-8 as the bytes that it was."""
    if isinstance(value, str):
        try:
            value.encode()
        except UnicodeEncodeError:
            return value.encode("utf-8", "surrogateescape")
    return value


def _beside(path: Path) -> Path:
    return path.with_name(f"{path.name}.damaged-{datetime.now(UTC):%Y%m%dT%H%M%S%f}")


def _mend_findings(
    url: str, data: Path, findings: list[Finding], done: list[str], *, rescue: bool, images: str | None
) -> bool:
    """Mend findings one by one; returns whether any was mended in the database."""
    changed = False
    database = Database(url) if any(finding.mend for finding in findings) else None
    if images is not None and (orphans := [finding.where for finding in findings if is_orphan(finding)]):
        done.extend(_remove_objects(url, data, images, orphans, rescue=rescue))
    for finding in findings:
        if finding.mend is not None and database is not None:
            try:
                with database.writing() as connection:
                    told = finding.mend(connection)
            except (*UNREADABLE, OSError, ValueError) as error:
                done.append(f"{finding.where}: {finding.what}; could not be mended ({error})")
            else:
                line = f"{finding.where}: {finding.what}; {told}"
                changed |= line not in done
                done.extend([line] if line not in done else [])
        elif images is None and is_orphan(finding):
            done.append(_put_away(data, finding, rescue=rescue))
    if database is not None:
        database.close()
    return changed


def _remove_objects(url: str, data: Path, images: str, orphans: list[str], *, rescue: bool) -> Iterator[str]:
    """Remove images of a store that no view needs; what another service writes just now has its lock, and is kept."""
    if rescue:
        yield from (f"{where}: {ORPHAN}; kept: its view may be lost, enrol it again" for where in orphans)
        return
    with closing(Database(url)) as database, closing(open_images(database, data, images)) as place:
        removed = place.discard([where.rpartition("/")[2] for where in orphans]).removed
    yield f"{images}: {removed} of {len(orphans)} images that no view needs were removed"


def _put_away(data: Path, finding: Finding, *, rescue: bool) -> str:
    """Remove an orphaned file, or keep it when its view may have been lost with the database's rows."""
    path = data / finding.where
    try:
        if not rescue:
            path.unlink()
            return f"{finding.where}: {finding.what}; removed"
        (data / RESCUED).mkdir(exist_ok=True)
        path.rename(data / RESCUED / path.name)
    except OSError as error:
        return f"{finding.where}: {finding.what}; could not be removed ({error.strerror})"
    return f"{finding.where}: {finding.what}; moved to {RESCUED}/: its view may be lost, enrol it again"
