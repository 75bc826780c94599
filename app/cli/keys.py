"""``revisit keys create | list | revoke | clear``: who may call a service. They work on its data folder."""

import argparse
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.cli.options import Verbs
from app.cli.output import DONE, say, show, show_json, table, wrong_use
from app.cli.serve import place_of, refuse_missing, settings_of

if TYPE_CHECKING:
    from schemas.keys import KeyRecord
    from worker.service.keys import KeyService

_UNITS = {"m": "minutes", "h": "hours", "d": "days", "w": "weeks"}


def add(verbs: Verbs) -> None:
    """Declare the commands."""
    keys = verbs.add_parser(
        "keys",
        help="make, list and revoke the keys of a service",
        description="Make, list and revoke keys in the data folder, whether a service runs on it or not. With a key "
        "made, every route but /livez, /readyz, /version and the console asks for one at once.",
    )
    commands = keys.add_subparsers(title="commands", metavar="COMMAND", required=True)
    create = commands.add_parser("create", help="make a key and print it, once")
    create.add_argument("name", help="your own name for it, such as that of the robot that will use it")
    create.add_argument(
        "--scope",
        choices=("read", "write", "admin"),
        default="read",
        help="read: look and query (default); write: also enrol, change and delete views; admin: everything",
    )
    create.add_argument("--map", action="append", metavar="MAP", help="only this map; may be given several times")
    create.add_argument("--expires", metavar="SPAN", help="end by itself, after a span such as 90d, 12h, 30m or 4w")
    create.add_argument("--requests-per-minute", type=_count, metavar="N", help="limit of its own; 0: none")
    create.add_argument("--images-per-minute", type=_count, metavar="N", help="limit of its own; 0: none")
    create.add_argument("--mb-per-minute", type=_count, metavar="N", help="limit of its own, 10^6 bytes; 0: none")
    _works(create, run_create)
    _works(commands.add_parser("list", help="list keys; never the keys themselves"), run_list)
    revoke = commands.add_parser("revoke", help="end a key for ever; a running service refuses it within a second")
    revoke.add_argument("name", help="the name that it was made with")
    _works(revoke, run_revoke)
    clear = commands.add_parser("clear", help="forget all keys: anybody who reaches the service may then call")
    clear.add_argument("--yes", action="store_true", help="really")
    _works(clear, run_clear)


def _works(parser: argparse.ArgumentParser, run: Any) -> None:
    parser.add_argument("--data", type=Path, help="data folder of the service (default: data)")
    parser.add_argument("--json", action="store_true", help="answer as JSON, for machines")
    parser.set_defaults(run=run)


def _count(text: str) -> int:
    if not re.fullmatch(r"\d{1,9}", text):
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number below 10^9")
    return int(text)


@contextmanager
def _keys(arguments: argparse.Namespace, *, new: bool = False) -> "Iterator[KeyService]":
    """The keys of a data folder; `new`: a folder without a database gets one, otherwise it is refused."""
    settings = settings_of(arguments, "data")
    if not new:
        refuse_missing(settings, "keys create")
    from worker.service.keys import KeyService
    from worker.storage.store import open_store

    store = open_store(settings.database_url, settings.data)
    try:
        yield KeyService(store.keys)
    finally:
        store.close()


def run_create(arguments: argparse.Namespace) -> int:
    """Make a key: the key alone on stdout, what it is for on stderr."""
    from schemas.errors import InvalidParameters
    from schemas.keys import Rates

    now = datetime.now(UTC)
    rates = Rates(arguments.requests_per_minute, arguments.images_per_minute, arguments.mb_per_minute)
    expires = None if arguments.expires is None else now + _span(arguments.expires)
    with _keys(arguments, new=True) as keys:
        try:
            record, key = keys.create(
                arguments.name, arguments.scope, now, maps=arguments.map, expires_at=expires, rates=rates
            )
        except InvalidParameters as error:
            wrong_use(str(error))
        try:
            if arguments.json:
                show_json({"key": key, **_facts(record, now)})
            else:
                show(key)
        except OSError:  # nobody has seen it
            keys.remove(record.id)
            raise
    if not arguments.json:
        maps = "all maps" if record.maps is None else f"the maps {', '.join(record.maps)}"
        where = place_of(settings_of(arguments, "data"))
        what = f"{record.name}: {record.scope}, {maps}, kept in {where}"
        say(f"{what}. The key is shown this once; only its hash is kept.")
    return DONE


def _span(text: str) -> timedelta:
    form = re.fullmatch(r"([1-9]\d{0,4})([mhdw])", text)
    if form is None:
        wrong_use(f"--expires {text!r} needs a span such as 90d, 12h, 30m or 4w")
    return timedelta(**{_UNITS[form[2]]: int(form[1])})


def _facts(record: "KeyRecord", now: datetime) -> dict[str, Any]:
    """A key as machines are told of it."""
    times = {name: getattr(record, name) for name in ("created_at", "expires_at", "revoked_at", "last_used_at")}
    return {
        "id": record.id,
        "name": record.name,
        "scope": record.scope,
        "maps": record.maps,
        "state": record.state(now),
        "per_minute": asdict(record.rates),
        **{name: None if time is None else time.isoformat(timespec="seconds") for name, time in times.items()},
    }


def run_list(arguments: argparse.Namespace) -> int:
    """List keys, also those that are no longer in force."""
    now = datetime.now(UTC)
    with _keys(arguments) as keys:
        found = [_facts(record, now) for record in keys.all()]
    if arguments.json:
        show_json(found)
    elif not found:
        show("there are no keys: whoever reaches the service may do everything")
    else:
        heads = ("name", "key begins", "scope", "maps", "state", "created", "expires", "last used")
        rows = [
            (
                one["name"],
                f"rv_{one['id']}",
                one["scope"],
                "all" if one["maps"] is None else ",".join(one["maps"]),
                one["state"],
                *(None if one[time] is None else one[time][:10] for time in ("created_at", "expires_at")),
                None if one["last_used_at"] is None else f"{one['last_used_at'][:13]}h".replace("T", " "),
            )
            for one in found
        ]
        show(table(heads, rows))
    return DONE


def run_revoke(arguments: argparse.Namespace) -> int:
    """End a key."""
    now = datetime.now(UTC)
    with _keys(arguments) as keys:
        record = keys.revoke(arguments.name, now)
    if arguments.json:
        show_json({"id": record.id, "name": record.name, "revoked_at": now.isoformat(timespec="seconds")})
    else:
        show(f"revoked {record.name} (rv_{record.id}); a running service refuses it within a second")
    return DONE


def run_clear(arguments: argparse.Namespace) -> int:
    """Forget all keys."""
    if not arguments.yes:
        wrong_use(
            "without keys, anybody who reaches the service may read, enrol and delete; say --yes if that is meant"
        )
    with _keys(arguments) as keys:
        count = keys.clear()
    if arguments.json:
        show_json({"forgotten": count})
    else:
        show(f"forgot {count} keys; the service asks for none now")
    return DONE
