"""``revisit serve | worker``: run the service, or a further process that describes its images."""

import argparse
import logging
import os
import signal
import socket
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from app.cli import logs
from app.cli.listening import address, is_loopback, listen, serve_until_stopped
from app.cli.options import Verbs, integer
from app.cli.output import DONE, FAILED, Failure, show
from app.cli.processor import check_processor
from app.cli.starting import collecting_new, collecting_nothing

if TYPE_CHECKING:
    from schemas.settings import Settings
    from worker.runtime import Runtime
    from worker.service.keys import KeyService

log = logging.getLogger("revisit")

LOOK_EVERY_S = 5.0
"""Seconds between looks whether a worker can still describe images."""

LOOKS = 3
"""Looks in a row that must find that it cannot: after the first one, it may have been the machine that stood still."""


def add(verbs: Verbs) -> None:
    """Declare the commands."""
    serve = verbs.add_parser(
        "serve",
        help="run the service",
        description="Run the service until it is told to stop (Ctrl-C, SIGTERM). Flags win over REVISIT_* variables.",
    )
    serve.add_argument("--host", help="address to listen on (default: 127.0.0.1)")
    serve.add_argument("--port", type=integer, help="port to listen on; 0 picks a free one (default: 8000)")
    serve.add_argument(
        "--open",
        action="store_const",
        const=True,
        help="allow an address that others can reach, although anybody may then read, enrol and delete",
    )
    serve.add_argument("--preset", help="preset of maps made without one: default, paper, code-words")
    _common(serve)
    serve.set_defaults(run=run_serve)

    worker = verbs.add_parser(
        "worker",
        help="describe enrolled images in a process of its own",
        description="Describe enrolled images beside a service on the same data, so that it can answer queries. "
        "Run `serve` with REVISIT_INLINE_WORKER=false to leave all describing to workers.",
    )
    _common(worker)
    worker.set_defaults(run=run_worker)


def _common(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--data", type=Path, help="folder of the database and the images (default: data)")
    encoders = ("compact", "compact-open", "color", "lseg")
    parser.add_argument("--encoder", choices=encoders, help="network that describes images (default: compact)")
    parser.add_argument("--device", help="where the network runs: cpu, cuda, ... (default: cpu)")
    parser.add_argument("--threads", type=integer, help="of the network (default: one for each core that may be used)")


def settings_of(arguments: argparse.Namespace, *names: str) -> "Settings":
    """Settings from the environment and the named options; raises Failure (exit code 2) for a wrong one."""
    from schemas.errors import SetupError
    from schemas.settings import read_settings

    try:
        return read_settings(**{name: getattr(arguments, name) for name in names})
    except SetupError as error:
        raise Failure(str(error), 2) from None


def place_of(settings: "Settings") -> str:
    """Where a command keeps what it makes: `data` is another folder when the command runs elsewhere."""
    return str(settings.data.resolve()) if settings.database is None else "the database of REVISIT_DATABASE"


def refuse_missing(settings: "Settings", what_makes_one: str) -> None:
    """Raise Failure where the data folder has no database: one that is mistyped says nothing of the service."""
    if settings.database is None and not (settings.data / "revisit.db").exists():
        raise Failure(
            f"{settings.data.resolve()} has no database of a service: --data or REVISIT_DATA names its data folder; "
            f"`{what_makes_one}` begins a new one"
        )


def run_serve(arguments: argparse.Namespace) -> int:
    """Serve until SIGINT or SIGTERM, or until only another process can: a supervisor starts that."""
    check_processor()
    settings = settings_of(arguments, "host", "port", "open", "preset", "data", "encoder", "device", "threads")
    _refuse_open(settings)
    logs.configure(settings.log, settings.log_level)
    listening = listen(settings)
    try:
        with collecting_nothing():
            return _serve(settings, listening)
    finally:
        listening.close()


def _refuse_open(settings: "Settings") -> None:
    """Raise Failure unless the host is a loopback address, there is a key, one will be made, or `open` is set."""
    if is_loopback(settings.host) or settings.open or settings.first_key or _has_keys(settings):
        return
    raise Failure(
        f"{settings.host} can be reached by others, and there is no key: anybody could read, enrol and delete.\n"
        "Make one with `./revisit keys create NAME --scope admin`, listen on 127.0.0.1, or say --open if the network\n"
        "is yours.",
        2,
    )


def _has_keys(settings: "Settings") -> bool:
    if settings.database is None and not (settings.data / "revisit.db").exists():
        return False
    from worker.storage.store import open_store

    store = open_store(settings.database_url, settings.data)
    try:
        return bool(store.keys.all())
    finally:
        store.close()


def make_first_key(keys: "KeyService", settings: "Settings") -> None:
    """Make and print an admin key where others reach a service without keys and `first_key` is set.

    It is kept before it is printed: one that was printed works. One that could not be printed is forgotten again; after
    a kill between the two, `./revisit keys create` in the container makes another.
    """
    if is_loopback(settings.host) or settings.open or not settings.first_key or keys.all():
        return
    from worker.service.keys import FIRST

    record, key = keys.create(FIRST, "admin", datetime.now(UTC))
    try:
        show(f"revisit made an admin key, shown this once: {key}")
    except BaseException:
        keys.remove(record.id)
        raise


def _serve(settings: "Settings", listening: socket.socket) -> int:
    from app.http.application import application
    from app.http.service import Service
    from worker.runtime import build

    runtime = build(settings)
    make_first_key(runtime.services.keys, settings)
    service = Service.of(runtime)
    url = address(settings.host, listening.getsockname()[1])
    return serve_until_stopped(
        application(service),
        settings,
        listening,
        "service",
        drain=service.lifecycle.drain,
        announce=lambda: announce(runtime, url),
        beyond_help=service.lifecycle.beyond_help,
        leave=runtime.leave,
    )


def announce(runtime: "Runtime", url: str) -> None:
    """Print the address, the encoder, the data folder and the number of views."""
    settings = runtime.settings
    counts = runtime.store.maps.counts_of_all().values()
    views = sum(count.views.get("ready", 0) for count in counts)
    pending = sum(count.views.get("pending", 0) for count in counts)
    waiting = f", {pending} waiting to be described" if pending else ""
    lines = [
        f"revisit serves at {url}",
        f"  encoder   {runtime.encoder.name} on {settings.device}, preset {settings.preset}",
        f"  data      {settings.data.resolve()}",
        f"  enrolled  {views} views in {len(counts)} maps{waiting}",
        f"  console   {url}/      documentation {url}/docs",
        f"  try       curl -F image=@photo.jpg {url}/enroll",
    ]
    keys = runtime.services.keys.all()
    if keys:
        in_force = sum(key.state(datetime.now(UTC)) == "valid" for key in keys)
        lines.append(f"  keys      {in_force} in force; every call needs one")
    show("\n".join(lines))
    if not keys and not is_loopback(settings.host):
        log.warning(
            "OPEN: listening on %s without keys; whoever can reach this port may read, enrol and delete",
            settings.host,
            extra={"event": "open"},
        )


def run_worker(arguments: argparse.Namespace) -> int:
    """Describe images until SIGINT or SIGTERM, or until only another process can: its supervisor starts that."""
    check_processor()
    settings = settings_of(arguments, "data", "encoder", "device", "threads")
    logs.configure(settings.log, settings.log_level)
    stop = threading.Event()
    with collecting_nothing():
        from worker.runtime import build

        runtime = build(settings, serving=False)

        def on_signal(number: int, _: object) -> None:
            """On the first signal stop in order, on the second at once: what it waits for may hang."""
            if stop.is_set():
                _end(f"stopped at once by a second {signal.Signals(number).name}")
            stop.set()

        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, on_signal)
        runtime.start()
        collecting_new()
    show(f"revisit worker describes images of {settings.data.resolve()} with {runtime.encoder.name}")
    looks = 0
    try:
        while not stop.wait(LOOK_EVERY_S):
            trouble = runtime.beyond_help
            looks = 0 if trouble is None else looks + 1
            if looks == LOOKS:
                runtime.leave()
                _end(f"ends, so that it is started anew: {trouble}")
    finally:
        runtime.stop()  # finishes the images being encoded; the others go back to the queue
    log.info("stopped")
    return DONE


def _end(why: str) -> NoReturn:
    """End the process without waiting for its threads; what was acknowledged is on disk."""
    log.critical(why, extra={"event": "ended_at_once"})
    logging.shutdown()
    os._exit(FAILED)
