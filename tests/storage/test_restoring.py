"""What is no whole snapshot is refused, and a restoration that ends half way leaves nothing."""

import json
import os
import random
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import time_machine

from schemas.errors import BadSnapshot, Conflict, DiskFull
from schemas.records import Filters
from tests.storage.carried import contents, filled, made
from tests.storage.databases import data_folder, postgres_schema, sqlite_url
from tests.storage.material import NOW, enroll
from worker.storage import space
from worker.storage.owner_file import OWNER
from worker.storage.store import SqlStore, open_store

ROOT = Path(__file__).parents[2]


def test_a_snapshot_of_a_map_that_is_there_is_refused(store: SqlStore) -> None:
    filled(store)
    path = made(store)
    before = contents(store)

    with pytest.raises(Conflict, match="exists already"):
        store.restoring.restore(path, None, NOW)

    assert contents(store) == before


def everything(folder: Path) -> list[object]:
    """All rows but those of processes, and all files of images."""
    with closing(sqlite3.connect(folder / "revisit.db")) as database:
        names = [name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        rows = [
            sorted(map(repr, database.execute(f"SELECT * FROM {name}")))
            for name in sorted(names)
            if name != "sqlite_sequence"
        ]
    return [
        rows,
        sorted(
            path.name
            for path in (folder / "pictures").rglob("*")
            if path.is_file() and path.name not in (".lock", OWNER)
        ),
    ]


def test_a_changed_byte_anywhere_is_refused_and_changes_nothing(elsewhere: SqlStore) -> None:
    """A bit, or all bits, of bytes at its beginning and end and of many between; and ends that are cut off."""
    with data_folder() as folder, closing(open_store(sqlite_url(folder), folder)) as store:
        filled(store, 2)
        path = made(store)
        sound = path.read_bytes()
    draw = random.Random(1)
    between = draw.sample(range(3000, len(sound) - 5000), 100)
    for at in [*range(0, 3000, 23), *between, *range(len(sound) - 5000, len(sound), 23)]:
        broken = bytearray(sound)
        broken[at] ^= draw.choice((1 << draw.randrange(8), 0xFF))
        refuses(elsewhere, bytes(broken))
    for cut in (0, 1, 511, 512, 513, len(sound) // 2, len(sound) - 1, len(sound) - 1024):
        refuses(elsewhere, sound[:cut])
    refuses(elsewhere, sound + b"\0")
    assert elsewhere.maps.all() == []


def refuses(store: SqlStore, body: bytes) -> None:
    """Restoring these bytes is refused in words, before anything is written."""
    path = store.snapshots.receiving("test")
    path.write_bytes(body)
    before = everything(path.parents[1])
    with pytest.raises(BadSnapshot, match="nothing was changed"):
        store.restoring.restore(path, None, NOW)
    assert everything(path.parents[1]) == before


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (b'"version":2', b'"version":3', "version 3; this program"),
        (b'"version":2', b'"version":1', "line 1 of its part views/000001.ndjson cannot be used"),
        (b'"keypoints":112', b'"keypoints":999', "the description of the view"),
        (b'"keypoints":112', b'"keypoints":0  ', "the description of the view"),
        (b'"format":"revisit-snapshot"', b'"format":"revisit-backups!"', "revisit-backups!"),
        (b'"map":"campus"', b'"map":"../pus"', "map"),
        (b'"views":5', b'"views":6', "6"),
    ],
)
def test_what_somebody_wrote_himself_is_read_with_care(
    store: SqlStore, elsewhere: SqlStore, old: bytes, new: bytes, told: str
) -> None:
    """With a manifest that fits."""
    filled(store)
    body = made(store).read_bytes()
    assert old in body
    path = elsewhere.snapshots.receiving("forged")
    path.write_bytes(forged(body.replace(old, new, 1)))

    with pytest.raises(BadSnapshot, match=told):
        elsewhere.restoring.restore(path, None, NOW)

    assert elsewhere.maps.all() == []


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda parts, at: parts.insert(at + 1, parts.pop(at)), "the description of the view"),
        (lambda parts, at: parts.insert(at, parts[at]), "stands where number 1 belongs"),
        (lambda parts, at: parts.pop(at), "the description of the view"),
        (lambda parts, at: parts.pop(at + 1), "are of no views"),
        (lambda parts, at: parts.insert(at, (parts[at][0], parts.pop(at)[1] + b"x")), "have not all"),
    ],
)
def test_descriptions_and_views_that_do_not_fit_each_other_are_refused(
    store: SqlStore, elsewhere: SqlStore, change: Callable[[list[tuple[str, bytes]], int], None], told: str
) -> None:
    filled(store)
    path = elsewhere.snapshots.receiving("forged")
    path.write_bytes(forged(made(store).read_bytes(), lambda parts: change(parts, 6)))

    with pytest.raises(BadSnapshot, match=told):
        elsewhere.restoring.restore(path, None, NOW)

    assert elsewhere.maps.all() == []


def forged(body: bytes, change: Callable[[list[tuple[str, bytes]]], None] = lambda parts: None) -> bytes:
    """Its parts, changed, with a manifest that fits."""
    import hashlib
    import io
    import tarfile

    with tarfile.open(fileobj=io.BytesIO(body)) as tar:
        parts = [(one.name, tar.extractfile(one).read()) for one in tar]  # type: ignore[union-attr]
    change(parts)
    lines = b"".join(
        json.dumps(
            {"name": name, "sha256": hashlib.sha256(part).hexdigest(), "size": len(part)}, separators=(",", ":")
        ).encode()
        + b"\n"
        for name, part in parts[:-2]
    )
    seal = hashlib.sha256(lines).hexdigest().encode()
    written = io.BytesIO()
    for name, part in [*parts[:-2], ("manifest.ndjson", lines), ("manifest.sha256", seal)]:
        info = tarfile.TarInfo(name)
        info.size = len(part)
        written.write(info.tobuf(tarfile.GNU_FORMAT) + part + bytes(-len(part) % 512))
    return written.getvalue() + bytes(1024)


def test_a_full_disk_is_noticed_before_anything_is_written(
    store: SqlStore, elsewhere: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    filled(store)
    path = made(store)
    size = path.stat().st_size
    elsewhere._database.space = space.Space([path.parent], 1000)
    monkeypatch.setattr(space.Space, "_available", lambda self, folder: 2000 + size)

    with pytest.raises(DiskFull):
        elsewhere.restoring.restore(path, None, NOW)

    assert elsewhere.maps.all() == []


def test_a_failure_in_the_middle_leaves_nothing(
    store: SqlStore, elsewhere: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    filled(store)
    enroll(elsewhere, "view 1", map="mine")
    folder = elsewhere.snapshots.receiving("x").parents[1]
    before = everything(folder)[1]
    add = elsewhere._images.add
    count = iter(range(100))

    def failing(images: dict[str, bytes]) -> None:
        if next(count) == 3:
            raise DiskFull("no room")
        add(images)

    monkeypatch.setattr("worker.storage.restoring.MOST_IMAGES", 1)
    monkeypatch.setattr(elsewhere._images, "add", failing)
    with pytest.raises(DiskFull):
        elsewhere.restoring.restore(made(store), None, NOW)

    assert [record.name for record in elsewhere.maps.all()] == ["mine"]
    assert everything(folder)[1] == before


KILLED = """
import os, sys
from pathlib import Path
from tests.storage.databases import sqlite_url
from tests.storage.material import NOW
from worker.storage import restoring
from worker.storage.store import open_store
folder, snapshot, after = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
restoring.MOST_IMAGES = 1
store = open_store(sqlite_url(folder), folder)
steps = 0
def dying(call):
    def step(*arguments):
        global steps
        steps += 1
        if steps == after:
            os.kill(os.getpid(), 9)
        return call(*arguments)
    return step
store._images.add = dying(store._images.add)
real = type(store._database).writing
store._database.writing = dying(lambda *a, **k: real(store._database, *a, **k))
store.restoring.restore(snapshot, None, NOW)
print("restored", steps)
"""


def test_a_kill_at_any_step_leaves_no_map_and_nothing_after_a_start(store: SqlStore, tmp_path: Path) -> None:
    filled(store)
    path = made(store)
    for after in (2, 6, 15, 100):  # before the views, among the images, before the map gets its name
        folder = tmp_path / str(after)
        folder.mkdir()
        done = subprocess.run(
            [sys.executable, "-c", KILLED, str(folder), str(path), str(after)],
            cwd=ROOT,
            env=os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'client'}"},
            capture_output=True,
            text=True,
            check=False,
        )
        with closing(open_store(sqlite_url(folder), folder)) as after_kill:
            if after == 100:
                assert done.stdout == "restored 15\n"
                assert contents(after_kill) == contents(store)
                continue
            assert done.returncode == -9, done.stderr
            assert after_kill.maps.all() == []
            assert after_kill.views.list(None, Filters())[0] == []
            after_kill.recover()
            assert everything(folder)[1] == []
            after_kill.restoring.restore(path, None, NOW)
            assert contents(after_kill) == contents(store)


def test_a_service_whose_clock_is_ahead_leaves_the_restoration_of_another_alone(
    elsewhere: SqlStore, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever is at work says so by the clock of the database, which both can read."""
    filled(elsewhere)
    with (
        postgres_schema() as url,
        data_folder() as folder,
        closing(open_store(url, data)) as store,
        closing(open_store(url, folder)) as ahead,
    ):
        add = store._images.add

        def meanwhile(images: dict[str, bytes]) -> None:
            with time_machine.travel(datetime.now(UTC) + timedelta(hours=1)):
                ahead.tend()
                if ahead.removals._finishing is not None:
                    ahead.removals._finishing.join()
            add(images)

        monkeypatch.setattr(store._images, "add", meanwhile)
        store.restoring.restore(made(elsewhere), None, NOW)
        assert contents(store) == contents(elsewhere)
