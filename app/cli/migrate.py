"""``revisit migrate``: bring the database up to date."""

import argparse
from pathlib import Path

from app.cli.options import Verbs
from app.cli.output import DONE, show
from app.cli.serve import refuse_missing, settings_of


def add(verbs: Verbs) -> None:
    """Declare the command."""
    migrate = verbs.add_parser("migrate", help="bring the database of a stopped service up to date")
    migrate.add_argument("--data", type=Path, help="data folder of the stopped service (default: data)")
    migrate.set_defaults(run=run_migrate)


def run_migrate(arguments: argparse.Namespace) -> int:
    """Bring the database to the newest schema."""
    settings = settings_of(arguments, "data")
    refuse_missing(settings, "serve")
    from worker.storage.migrating import migrate

    settings.data.mkdir(parents=True, exist_ok=True)
    show(f"the tables are at revision {migrate(settings.database_url, settings.data, settings.index)}")
    return DONE
