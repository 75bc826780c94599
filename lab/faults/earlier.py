"""A data folder as an earlier version would have left it: the tables of an older revision with today's rows."""

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import sqlalchemy as sa
from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory

from worker.storage.database import Database
from worker.storage.migrating import SCRIPTS
from worker.storage.owner_file import OWNER

NAME = "revisit.db"


def rewound(data: Path, to: Path) -> str:
    """Copy a data folder that no process uses, with the tables of the revision before the newest.

    Columns and tables that the newest revision added are left out.

    Parameters
    ----------
    data, to : Path
        A folder, and one that does not exist yet.

    Returns
    -------
    str
        The revision of the copy, such as ``0004``.
    """
    shutil.copytree(data, to)
    for left in to.glob(f"{NAME}*"):
        left.unlink()
    config = Config()
    config.set_main_option("script_location", str(SCRIPTS).replace("%", "%%"))
    revision = [script.revision for script in ScriptDirectory.from_config(config).walk_revisions()][1]
    database = Database(f"sqlite:///{to / NAME}")
    try:
        with database.writing() as connection:
            config.attributes["connection"] = connection
            command.upgrade(config, revision)
            names = set(sa.inspect(connection).get_table_names())
            for name in names & {"clock", "installation"}:  # which have a row from the beginning
                connection.execute(sa.text(f"DELETE FROM {name}"))
    finally:
        database.close()
    if "installation" not in names:  # and so no file that says whose the images are
        (to / "pictures" / OWNER).unlink(missing_ok=True)
    _fill(to / NAME, data / NAME)
    return revision


def _fill(old: Path, present: Path) -> None:
    with closing(sqlite3.connect(old)) as connection:
        connection.execute("ATTACH ? AS present", (str(present),))
        tables = [name for (name,) in connection.execute("SELECT name FROM main.sqlite_master WHERE type = 'table'")]
        for table in tables:
            if table == "alembic_version" or table.startswith("sqlite_"):
                continue
            shared = sorted(_columns(connection, "main", table) & _columns(connection, "present", table))
            if shared:
                names = ", ".join(f'"{name}"' for name in shared)
                connection.execute(f'INSERT INTO main."{table}" ({names}) SELECT {names} FROM present."{table}"')
        connection.commit()


def _columns(connection: sqlite3.Connection, schema: str, table: str) -> set[str]:
    return {row[1] for row in connection.execute(f'PRAGMA {schema}.table_info("{table}")')}
