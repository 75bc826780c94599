"""``revisit snapshot | restore``: maps as files, and maps made from such files."""

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING

from app.cli.options import Verbs, add_service_options, service_of
from app.cli.output import DONE, Failure, job_progress, say, show, show_json, size, table, wrong_use
from app.cli.serve import place_of, settings_of

if TYPE_CHECKING:
    from revisit_client import Revisit
    from revisit_client.wire import Snapshot


def add(verbs: Verbs) -> None:
    """Declare the commands."""
    snapshot = verbs.add_parser(
        "snapshot",
        help="write a map, or all of them, to files",
        description="Write a map to one file: views, images, descriptions, and what the map learned. The service goes "
        "on working meanwhile. The file is fetched here, and removed from the service unless --keep is given.",
    )
    snapshot.add_argument("map", nargs="?", help="name of the map")
    snapshot.add_argument("--all", action="store_true", help="every map, a file each")
    snapshot.add_argument("--output", type=_path, metavar="PATH", help="file, or folder to put it into (default: .)")
    snapshot.add_argument("--keep", action="store_true", help="leave the file with the service too")
    kept = snapshot.add_mutually_exclusive_group()
    kept.add_argument("--list", action="store_true", help="list the snapshots that the service keeps")
    kept.add_argument("--fetch", metavar="ID", help="fetch one that the service keeps, which goes on keeping it")
    kept.add_argument("--delete", metavar="ID", help="remove one that the service keeps")
    add_service_options(snapshot)
    snapshot.set_defaults(run=run_snapshot)

    restore = verbs.add_parser(
        "restore",
        help="make a map from a file that `snapshot` wrote",
        description="Make a map from a snapshot. Works on the data folder of a stopped service, or with --url through "
        "a running one. The whole file is verified before anything is written.",
    )
    restore.add_argument("file", type=Path, help="the file")
    restore.add_argument("--as", dest="name", metavar="NAME", help="name of the new map (default: the one it had)")
    restore.add_argument("--data", type=Path, help="data folder of the stopped service (default: data)")
    add_service_options(restore, "restore through the running service at this address; REVISIT_URL says nothing here")
    restore.set_defaults(run=run_restore)


def _path(text: str) -> Path:
    """A path; what ends with a slash is meant as a folder, and has to be one."""
    path = Path(text)
    if text.endswith("/") and not path.is_dir():
        raise argparse.ArgumentTypeError(f"there is no folder {text}; make it first")
    return path


def run_snapshot(arguments: argparse.Namespace) -> int:
    """Make snapshots, and fetch them."""

    if arguments.list or arguments.fetch is not None or arguments.delete is not None:
        if arguments.map is not None or arguments.all or arguments.keep:
            wrong_use("--list, --fetch and --delete are about snapshots that are kept: give no map, --all or --keep")
        if arguments.output is not None and arguments.fetch is None:
            wrong_use("--output goes with snapshots that are made or fetched")
        return _of_kept(arguments)
    if (arguments.map is None) != arguments.all:
        wrong_use("name one map, or say --all")
    if arguments.all and arguments.output is not None and not arguments.output.is_dir():
        wrong_use(f"--all writes a file for each map: {arguments.output} needs to be a folder")
    done = []
    with service_of(arguments) as revisit:
        names = [facts.name for facts in revisit.maps()] if arguments.all else [arguments.map]
        for name in names:
            made, path = _fetched(revisit, name, arguments)
            done.append({"file": str(path), **made.model_dump(mode="json")})
            if not arguments.json:
                show(f"{path}: {made.views} views of map {name}, {size(made.bytes)}")
    if arguments.json:
        show_json(done)
    return DONE


def _fetched(revisit: "Revisit", name: str, arguments: argparse.Namespace) -> "tuple[Snapshot, Path]":
    job = revisit.make_snapshot(name)
    say(f"job {job.id} is running; interrupting this command does not stop it")
    with job_progress(f"views of map {name}", quiet=arguments.json) as follow:
        revisit.wait_for_job(job.id, timeout=24 * 3600, follow=follow)
    (made,) = [one for one in revisit.snapshots() if one.id == job.id]
    path = _downloaded(revisit, made, arguments.output)
    if not arguments.keep:
        revisit.delete_snapshot(made.id)
    return made, path


def _downloaded(revisit: "Revisit", made: "Snapshot", output: Path | None) -> Path:
    from revisit_client import Unreachable

    path = output or Path()
    if path.is_dir():
        path /= f"{made.map}-{made.created_at:%Y%m%dT%H%M%SZ}.snapshot"
    try:
        return revisit.download_snapshot(made.id, path)
    except OSError as error:
        raise Failure(f"{path}: {error.strerror}; the service keeps the snapshot {made.id}") from error
    except Unreachable as error:
        raise Failure(f"{error}\n`revisit snapshot --fetch {made.id}` fetches it once the service is there") from error


def _of_kept(arguments: argparse.Namespace) -> int:
    """List the snapshots that the service keeps, or fetch or remove one."""

    with service_of(arguments) as revisit:
        if arguments.delete is not None:
            chosen, did = [revisit.delete_snapshot(arguments.delete)], "removed"
        else:
            chosen, did = revisit.snapshots(), ""
        if arguments.fetch is not None:
            chosen = [one for one in chosen if one.id == arguments.fetch]
            if not chosen:
                raise Failure(f"the service keeps no snapshot {arguments.fetch}; `revisit snapshot --list` lists them")
            did = f"fetched to {_downloaded(revisit, chosen[0], arguments.output)}"
    if arguments.json:
        show_json(chosen)
    elif did:
        show(f"{chosen[0].id}: {chosen[0].views} views of map {chosen[0].map}, {size(chosen[0].bytes)}, {did}")
    else:
        rows = [(one.id, one.map, one.views, size(one.bytes), f"{one.created_at:%Y-%m-%d %H:%M:%S}") for one in chosen]
        show(table(("snapshot", "map", "views", "size", "made"), rows))
    return DONE


def run_restore(arguments: argparse.Namespace) -> int:
    """Make a map from a file."""
    if arguments.url is not None:
        if arguments.data is not None:
            wrong_use("--url is for a running service, --data for a stopped one; give one of them")
        made = _sent(arguments)
    else:
        made = _stored(arguments)
    if arguments.json:
        show_json(made)
    else:
        from schemas.settings import without_password

        ids = "with new ids, since some were in use" if made["new_ids"] else "with the ids they had"
        where = (
            f"at {without_password(arguments.url)}"
            if arguments.url
            else f"in {place_of(settings_of(arguments, 'data'))}"
        )
        show(f"restored the map {made['map']} {where}: {made['views']} views, {ids}")
        if made["pending"]:
            say(f"{made['pending']} of them have no description yet; the service describes them")
    return DONE


def _sent(arguments: argparse.Namespace) -> "dict[str, object]":

    with service_of(arguments) as revisit:
        return revisit.restore(arguments.file, name=arguments.name).model_dump(mode="json")


def _stored(arguments: argparse.Namespace) -> "dict[str, object]":
    from dataclasses import asdict
    from datetime import UTC, datetime

    from schemas.errors import SetupError
    from schemas.values import MAP_NAME, PATTERNS_IN_WORDS

    if arguments.name is not None and not re.fullmatch(MAP_NAME, arguments.name):
        wrong_use(f"--as {arguments.name!r} is no name of a map, which {PATTERNS_IN_WORDS[MAP_NAME]}")
    settings = settings_of(arguments, "data")
    from worker.storage.locks import lock_for_serving
    from worker.storage.snapshot_files import SnapshotReader
    from worker.storage.store import open_store

    SnapshotReader(arguments.file).facts()  # a mistyped file makes no data folder
    settings.data.mkdir(parents=True, exist_ok=True)
    try:  # a service that starts meanwhile would take what is half restored for what a crash left
        lock = lock_for_serving(settings.data, datetime.now(UTC))
    except SetupError as error:
        raise Failure(f"{error}\nOr restore through the running service: --url URL") from None
    try:
        reserve = round(settings.reserve_mb * 1_000_000)
        store = open_store(settings.database_url, settings.data, reserve, settings.images)
        store.refuse_foreign()
        try:
            store.recover()
            return asdict(store.restoring.restore(arguments.file, arguments.name, datetime.now(UTC)))
        finally:
            store.close()
    finally:
        lock.release()
