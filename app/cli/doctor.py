"""``revisit doctor``: examine an installation, its data and its service; mend the data."""

import argparse
import os
import platform
from importlib.metadata import PackageNotFoundError, distributions, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.cli.auditing import SAMPLE, audit
from app.cli.listening import url_of_environment
from app.cli.options import Verbs, add_service_options
from app.cli.output import DONE, FAILED, Failure, show, show_json, size
from app.cli.serve import settings_of

if TYPE_CHECKING:
    from schemas.settings import Settings

MISSING = "missing"
LIBRARIES = (
    "onnxruntime", "torch", "numpy", "opencv-python-headless", "faiss-cpu", "pillow", "sqlalchemy", "alembic",
    "fastapi", "starlette", "uvicorn", "pydantic", "httpx",
)  # fmt: skip
LEAST_FREE, FEW_INODES = 1_000_000_000, 1000
"""Bytes and files for which a file system should have room."""


def add(verbs: Verbs) -> None:
    """Declare the command."""
    doctor = verbs.add_parser(
        "doctor",
        help="examine an installation and its data, down to every row and image; mend what can be mended",
        description="Examine this installation, every row and every image of its data folder and, when a service is "
        "running, query with enrolled images: each has to find itself. One finding a line: what, where, what to do. "
        "Exit code 1 when there is any.",
    )
    doctor.add_argument("--data", type=Path, help="data folder of the service (default: data)")
    doctor.add_argument(
        "--all", action="store_true", help=f"query with all enrolled images, not with {SAMPLE} of a map"
    )
    doctor.add_argument(
        "--repair",
        action="store_true",
        help="mend damaged data; the service and its workers must be stopped. Exit code 1 when findings are left",
    )
    add_service_options(doctor)
    doctor.set_defaults(run=run_doctor)


def run_doctor(arguments: argparse.Namespace) -> int:
    """Examine everything and print a report; returns 1 when something is wrong."""
    from worker.encoders.cores import usable_cores

    settings = settings_of(arguments, "data")
    if arguments.repair:
        return _repair(settings, as_json=arguments.json)
    cores = usable_cores()
    findings: list[str] = []
    report: dict[str, Any] = {
        "versions": versions(),
        "machine": {
            "system": platform.platform(),
            "cores": cores,
            "threads": settings.threads or cores,
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


def _repair(settings: "Settings", *, as_json: bool) -> int:
    """Mend the data folder of a stopped service; returns 1 when something is left."""
    from worker.storage.repairing import repair

    if not settings.data.is_dir():
        raise Failure(f"there is no data folder {settings.data}; see REVISIT_DATA")
    done, left = repair(settings.database_url, settings.data, settings.images)
    if as_json:
        show_json({"done": done, "findings": [str(finding) for finding in left]})
    else:
        show("done")
        for line in done or ["nothing: there was nothing to mend"]:
            show(f"  {line}")
        show("left")
        for line in [str(finding) for finding in left] or ["nothing"]:
            show(f"  {line}")
    return FAILED if left else DONE


def versions() -> dict[str, str]:
    """Versions of revisit, Python and the libraries; ``missing`` for one that is not installed."""
    from app.version import VERSION

    found = {"revisit": VERSION, "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = MISSING
    return found


def torch_flavour() -> str:
    """Which build of torch is installed; read from package metadata, since importing torch takes seconds."""
    installed = versions()["torch"]
    if installed == MISSING:
        return "not installed: compact on a CPU alone"
    local = installed.partition("+")[2]
    if local:
        return f"{local} build"
    # A wheel without a local version is a CUDA build when NVIDIA's packages are installed.
    cuda = any((d.name or "").startswith("nvidia-") for d in distributions())
    return "CUDA build" if cuda else "cpu build"


def _data(settings: "Settings", findings: list[str]) -> dict[str, Any]:
    """Examine the data folder, read only, so that a running service is not disturbed; appends to `findings`."""
    folder = settings.data
    if not folder.exists():
        return {"folder": str(folder.resolve()), "state": "not there yet; `./revisit serve` makes it"}
    from worker.storage.space import LEAST_INODES, free_inodes

    report: dict[str, Any] = {"folder": str(folder.resolve())}
    try:
        free = os.statvfs(folder).f_bavail * os.statvfs(folder).f_frsize
        report["free"] = size(free)
        if free < LEAST_FREE:
            findings.append(f"{folder}: only {size(free)} are free; enrolments are refused when nothing is left")
        inodes = free_inodes(folder)
        if inodes is not None and inodes < FEW_INODES:
            findings.append(
                f"{folder}: its disk takes only {inodes} further files (`df -i`); with fewer than {LEAST_INODES} "
                "enrolments are refused"
            )
        begun = any([*folder.glob("revisit.db*"), *folder.glob("pictures/*/*/*")])
        if folder.is_dir() and settings.database is None and not begun:
            return report | {"tables": "none yet"}
    except OSError as error:
        findings.append(f"{folder}: cannot be read ({error.strerror}); see its permissions")
        return report
    from worker.storage.examining import examine
    from worker.storage.migrating import newest
    from worker.storage.repairing import is_served

    if settings.index != "faiss":
        from worker.storage.examining_vectors import vector_findings

        index, lacking = vector_findings(settings.database_url, approximate=settings.index == "pgvector-hnsw")
        report["index"] = index
        findings += [str(finding) for finding in lacking]
    found = list(examine(settings.database_url, folder, running=is_served(folder), images=settings.images))
    findings += [str(finding) for finding in found]
    return report | {"tables": newest(), "findings": len(found)}


def _service(arguments: argparse.Namespace, findings: list[str]) -> dict[str, Any]:
    """Check the running service: readiness, and whether enrolled images find themselves; appends to `findings`."""
    from revisit_client import ClientError, Revisit, Unreachable

    with Revisit(arguments.url or url_of_environment(), key=arguments.key, patience=10) as revisit:
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
            result = audit(revisit, facts.name, every=arguments.all, quiet=arguments.json)
            report["maps"][facts.name] = {"views": facts.views, "revision": facts.revision, **result}
            if failed:
                findings.append(f"map {facts.name}: {failed} views failed; `./revisit views --state failed` says why")
            findings += [f"map {facts.name}: {line}" for line in result["findings"]]
            if waiting:
                report["maps"][facts.name]["lag"] = f"{waiting} views wait to be described"
    return report


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
        show(f"  map {name:20} {counts}; {facts['found']} of {facts['queried']} images find themselves")
    show("findings")
    for finding in report["findings"] or ["none"]:
        show(f"  {finding}")
