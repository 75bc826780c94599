"""``revisit migrate | doctor``: migrate the database; check an installation, its data and its service."""

import argparse
import os
import platform
import random
from importlib.metadata import PackageNotFoundError, distributions, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.cli.console import DONE, FAILED, Verbs, progress_bar, show, show_json, size, speaks
from app.cli.serve import settings_of

if TYPE_CHECKING:
    from revisit_client import Revisit

    from schemas.settings import Settings

LIBRARIES = (
    "onnxruntime", "torch", "numpy", "opencv-python-headless", "faiss-cpu", "pillow", "sqlalchemy", "alembic",
    "fastapi", "starlette", "uvicorn", "pydantic", "httpx",
)  # fmt: skip
SAMPLE = 20


def add(verbs: Verbs) -> None:
    """Declare the commands."""
    migrate = verbs.add_parser("migrate", help="bring the database of a stopped service up to date")
    migrate.add_argument("--data", type=Path)
    migrate.set_defaults(run=run_migrate)

    doctor = verbs.add_parser(
        "doctor",
        help="versions, limits, the state of the data, and whether every enrolled image finds itself",
        description="Check this installation and, when a service is running, query with enrolled images: each has to "
        "find itself. Exit code 1 when something is wrong.",
    )
    doctor.add_argument("--data", type=Path)
    doctor.add_argument(
        "--all", action="store_true", help=f"query with all enrolled images, not with {SAMPLE} of a map"
    )
    speaks(doctor)
    doctor.set_defaults(run=run_doctor)


def run_migrate(arguments: argparse.Namespace) -> int:
    """Bring the database to the newest schema."""
    settings = settings_of(arguments, "data")
    from worker.storage.migrating import migrate

    settings.data.mkdir(parents=True, exist_ok=True)
    show(f"the tables are at revision {migrate(settings.database_url, settings.data)}")
    return DONE


def run_doctor(arguments: argparse.Namespace) -> int:
    """Check everything and print a report; returns 1 when something is wrong."""
    settings = settings_of(arguments, "data")
    findings: list[str] = []
    report: dict[str, Any] = {
        "versions": versions(),
        "machine": {
            "system": platform.platform(),
            "cores": os.cpu_count(),
            "threads": settings.threads or os.cpu_count(),
            "torch": torch_flavour(),
        },
        "limits": {
            "body_mb": settings.max_body_mb,
            "megapixels": settings.max_megapixels,
            "queue": settings.queue,
            "queries": settings.queries,
        },
        "data": _data(settings, findings),
        "service": _service(arguments, findings),
        "findings": findings,
    }
    if arguments.json:
        show_json(report)
    else:
        _tell(report)
    return FAILED if findings else DONE


def versions() -> dict[str, str]:
    """Versions of revisit, Python and the libraries; ``missing`` for one that is not installed."""
    from app.version import VERSION

    found = {"revisit": VERSION, "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "missing"
    return found


def torch_flavour() -> str:
    """Which build of torch is installed; read from package metadata, since importing torch takes seconds."""
    local = versions().get("torch", "").partition("+")[2]
    if local:
        return f"{local} build"
    # A wheel without a local version is a CUDA build when NVIDIA's packages are installed.
    cuda = any((d.name or "").startswith("nvidia-") for d in distributions())
    return "CUDA build" if cuda else "cpu build"


def _data(settings: "Settings", findings: list[str]) -> dict[str, Any]:
    """Check the data folder, read only, so that a running service is not disturbed; appends to `findings`."""
    folder = settings.data
    if not folder.is_dir():
        return {"folder": str(folder.resolve()), "state": "not there yet; `./revisit serve` makes it"}
    free = os.statvfs(folder).f_bavail * os.statvfs(folder).f_frsize
    if free < 1_000_000_000:
        findings.append(f"only {size(free)} free in {folder}; enrolments are refused when nothing is left")
    report: dict[str, Any] = {"folder": str(folder.resolve()), "free": size(free)}
    from worker.storage import migrating
    from worker.storage.database import Database

    if settings.database is None and not (folder / "revisit.db").exists():
        return report | {"tables": "none yet"}
    database = Database(settings.database_url)
    try:
        with database.reading() as connection:
            found = migrating.current(connection)
            report["tables"] = f"{found} of {migrating.newest()}"
            if not migrating.is_current(connection):
                findings.append(
                    f"the tables are at {found}, this version needs {migrating.newest()}: ./revisit migrate"
                )
    finally:
        database.close()
    return report


def _service(arguments: argparse.Namespace, findings: list[str]) -> dict[str, Any]:
    """Check the running service: readiness, and whether enrolled images find themselves; appends to `findings`."""
    from revisit_client import ClientError, Revisit, Unreachable

    with Revisit(arguments.url, key=arguments.key, patience=10) as revisit:
        try:
            readiness = revisit.readyz()
        except Unreachable:
            return {"url": revisit.url, "state": "not running; start it with `./revisit serve` for a full examination"}
        except ClientError as error:
            findings.append(str(error))
            return {"url": revisit.url, "state": "does not answer as revisit does"}
        report: dict[str, Any] = {"url": revisit.url, "ready": readiness.ready, "checks": readiness.checks}
        if not readiness.ready:
            findings.append("the service is not ready: " + "; ".join(f"{k}: {v}" for k, v in readiness.checks.items()))
            return report
        report["maps"] = {}
        for facts in revisit.maps():
            waiting, failed = facts.views.get("pending", 0), facts.views.get("failed", 0)
            audit = _audit(revisit, facts.name, every=arguments.all, quiet=arguments.json)
            report["maps"][facts.name] = {"views": facts.views, "revision": facts.revision, **audit}
            if failed:
                findings.append(f"map {facts.name}: {failed} views failed; `./revisit views --state failed` says why")
            if audit["lost"]:
                findings.append(f"map {facts.name}: {len(audit['lost'])} images do not find themselves")
            if waiting:
                report["maps"][facts.name]["lag"] = f"{waiting} views wait to be described"
    return report


def _audit(revisit: "Revisit", name: str, *, every: bool, quiet: bool) -> dict[str, Any]:
    """Query with enrolled images: each has to be its own best match, or tie with it within 1e-6."""
    views = list(revisit.views(name, state="ready"))
    answers = views if every or len(views) <= SAMPLE else random.Random(0).sample(views, SAMPLE)
    lost = []
    with progress_bar(len(answers), f"images of map {name} queried for themselves", quiet=quiet) as step:
        for view in answers:
            matches = revisit.query(revisit.image(view.id), map=name, top=5).matches
            best = [match.view.id for match in matches if match.score >= matches[0].score - 1e-6]
            if view.id not in best:
                lost.append(view.id)
            step(view.id)
    return {"queried": len(answers), "found": len(answers) - len(lost), "lost": lost}


def _tell(report: dict[str, Any]) -> None:
    for section in ("versions", "machine", "limits", "data"):
        show(section)
        for name, value in report[section].items():
            show(f"  {name:24} {value}")
    service = report["service"]
    show("service")
    for name, value in service.items():
        if name == "checks":
            value = ", ".join(f"{part} {state}" for part, state in value.items())
        if name != "maps":
            show(f"  {name:24} {value}")
    for name, facts in service.get("maps", {}).items():
        counts = ", ".join(f"{count} {state}" for state, count in facts["views"].items())
        show(f"  map {name:20} {counts}; {facts['found']} of {facts['asked']} images find themselves")
    show("findings")
    for finding in report["findings"] or ["none"]:
        show(f"  {finding}")
