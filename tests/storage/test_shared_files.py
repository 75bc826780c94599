"""Recordings and snapshots in an object store: whole or not there, found by every process, and swept when orphaned."""

import hashlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from schemas.errors import Damaged, DiskFull, NotFound, StorageFailed
from tests.storage.databases import data_folder, sqlite_url
from tests.storage.material import NOW, RECIPE, describe_all, enroll, facts, image
from tests.storage.object_store import ADDRESS, BUCKET, PREFIX, CuttingProxy, ObjectStore, aws, server
from worker.storage import object_files
from worker.storage.examining import examine
from worker.storage.object_files import ObjectFiles
from worker.storage.scratch import Scratch
from worker.storage.snapshot_files import SnapshotReader
from worker.storage.store import SqlStore, open_store

JOB = "0195f2a4-7c1e-7b3a-9d52-0a4c6f1e8b90"
LARGE = os.urandom(12_000_000)
"""Three parts of an upload."""


@pytest.fixture
def objects(monkeypatch: pytest.MonkeyPatch) -> ObjectStore:
    there = server()
    there.empty()
    for name, value in aws(there.url).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(object_files, "PART_BYTES", 5 * 1024 * 1024)
    return there


@pytest.fixture
def store(objects: ObjectStore, data: Path) -> Iterator[SqlStore]:
    """The store of one machine."""
    opened = open_store(sqlite_url(data), data, 0, ADDRESS)
    yield opened
    opened.close()


@pytest.fixture
def files(store: SqlStore) -> ObjectFiles:
    found = store._images.files
    assert found is not None
    return found


def quiet(*_: object) -> None: ...


def raising(error: Exception, after: int = 0) -> Callable[..., None]:
    """Raises when it is called for the so-and-so-many-th time."""
    calls = iter(range(1000))

    def tell(*_: object) -> None:
        if next(calls) == after:
            raise error

    return tell


def kept(store: SqlStore, job: str, body: bytes) -> None:
    """A recording that was received and kept for a job."""
    upload = store.uploads.receive(len(body))
    upload.write(body)
    upload.end()
    store.uploads.keep(upload, job, {"every_s": 2.0})
    upload.discard()


def running(store: SqlStore, job: str) -> None:
    store.jobs.queue_import(job, "campus", RECIPE, NOW)


@pytest.mark.parametrize("body", [b"", b"small", LARGE])
def test_a_file_comes_back_as_it_was_sent(files: ObjectFiles, objects: ObjectStore, data: Path, body: bytes) -> None:
    (data / "sent").write_bytes(body)
    digest = hashlib.sha256(body).hexdigest()

    assert files.put(data / "sent", "imports/x/upload") == digest
    assert files.fetch("imports/x/upload", data / "back", quiet) == digest
    assert (data / "back").read_bytes() == body
    with files.open("imports/x/upload") as file:
        file.seek(-min(3, len(body)), os.SEEK_END)
        assert file.read() == body[-3:]
    assert [(one.name, one.size) for one in files.below("imports")] == [("imports/x/upload", len(body))]
    assert objects.unfinished() == []


def test_an_upload_that_is_ended_leaves_nothing(files: ObjectFiles, objects: ObjectStore, data: Path) -> None:
    (data / "sent").write_bytes(LARGE)
    with pytest.raises(KeyError):
        files.put(data / "sent", "imports/x/upload", raising(KeyError("cancelled"), after=1))
    assert (objects.names(), objects.unfinished()) == ([], [])


def test_a_reader_goes_on_when_its_connection_breaks(
    objects: ObjectStore, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    proxy = CuttingProxy(objects.url)
    monkeypatch.setenv("AWS_ENDPOINT_URL_S3", proxy.url)
    opened = open_store(sqlite_url(data), data, 0, ADDRESS)
    files = opened._images.files
    assert files is not None
    (data / "sent").write_bytes(LARGE)
    files.put(data / "sent", "imports/x/upload")

    proxy.cuts = [2_000_000, 1_000_000]
    with files.open("imports/x/upload") as file:
        assert file.read() == LARGE
    assert proxy.cuts == []

    with files.open("imports/x/upload") as file:
        proxy.cuts = [1] * 50
        with pytest.raises(StorageFailed, match="cannot be reached"):
            file.read()
    proxy.close()
    opened.close()


def test_another_machine_finds_a_recording_and_it_is_gone_when_its_job_is(
    store: SqlStore, objects: ObjectStore, data: Path
) -> None:
    kept(store, JOB, LARGE)
    assert not any((data / "imports").iterdir())
    with data_folder() as other:
        elsewhere = open_store(sqlite_url(other), other, 0, ADDRESS)
        with elsewhere.uploads.opened(JOB, quiet) as (path, wanted):
            assert (path.read_bytes(), wanted) == (LARGE, {"every_s": 2.0})
            assert other in path.parents
        assert [one.name for one in (other / "scratch").iterdir()] == [".making"]
        elsewhere.uploads.discard(JOB)
        with pytest.raises(FileNotFoundError), elsewhere.uploads.opened(JOB, quiet):
            pass
        elsewhere.close()
    assert objects.names() == []
    store.uploads.discard(JOB)


def test_a_recording_that_is_damaged_in_the_store_is_not_imported(store: SqlStore, objects: ObjectStore) -> None:
    kept(store, JOB, b"a recording")
    objects.client.put_object(Bucket=BUCKET, Key=f"{PREFIX}imports/{JOB}/upload", Body=b"a recordinG")
    with pytest.raises(Damaged, match="send it again"), store.uploads.opened(JOB, quiet):
        pass


def test_fetching_a_recording_ends_when_its_job_does_and_where_the_disk_is_full(
    objects: ObjectStore, data: Path, store: SqlStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept(store, JOB, LARGE)
    with pytest.raises(KeyError), store.uploads.opened(JOB, raising(KeyError("cancelled"), after=1)):
        pass
    space = store.uploads._space
    assert space is not None
    monkeypatch.setattr(space, "admit", raising(DiskFull("the disk is full"), after=2))
    with pytest.raises(DiskFull), store.uploads.opened(JOB, quiet):
        pass
    assert [one.name for one in (data / "scratch").iterdir()] == [".making"]


def test_while_the_store_is_away_nothing_is_kept_and_what_is_done_with_is_swept_later(
    store: SqlStore, objects: ObjectStore, data: Path
) -> None:
    kept(store, JOB, b"done with")
    objects.stop()
    try:
        with pytest.raises(StorageFailed, match="cannot be reached"):
            kept(store, JOB.replace("a4", "a5"), b"new")
        store.uploads.discard(JOB)  # its job has ended: that is not undone
        with pytest.raises(StorageFailed), store.uploads.opened(JOB, quiet):
            pass
    finally:
        objects.start()
    assert len(objects.names()) == 2
    assert store.leftovers is not None
    assert store.leftovers.sweep() == 0  # it could be one whose job is being written just now
    assert store.leftovers.sweep(0) == 2
    assert objects.names() == []


def test_a_sweep_spares_what_jobs_need(store: SqlStore, objects: ObjectStore) -> None:
    running(store, JOB)
    kept(store, JOB, b"waits for a worker")
    enroll(store, "gate")
    describe_all(store)
    snapshot = store.jobs.queue_snapshot("campus", NOW).id
    made = JOB.replace("a4", "a6")
    store.snapshots.make("campus", made, NOW, quiet)
    of = {"Bucket": BUCKET, "Key": f"{PREFIX}snapshots/{snapshot}.snapshot"}
    objects.client.put_object(**of | {"Key": f"{PREFIX}snapshots/{snapshot}.digests"}, Body=b"")
    objects.client.create_multipart_upload(**of)
    before = objects.names()
    assert store.leftovers is not None

    assert store.leftovers.sweep(0) == 0
    assert (objects.names(), len(objects.unfinished())) == (before, 1)

    store.jobs.cancel(snapshot, NOW)
    store.jobs.cancel(JOB, NOW)
    assert store.leftovers.sweep(0) == 4
    digest = facts(image("gate")).sha256
    assert objects.names() == [
        f"{digest[:2]}/{digest[2:4]}/{digest}", f"snapshots/{made}.digests", f"snapshots/{made}.snapshot"
    ]  # fmt: skip
    assert objects.unfinished() == []


def test_a_snapshot_made_on_one_machine_is_read_listed_and_removed_on_another(
    store: SqlStore, objects: ObjectStore, data: Path
) -> None:
    view = enroll(store, "gate").view
    describe_all(store)
    record = store.snapshots.make("campus", JOB, NOW, quiet)
    assert not (data / "snapshots").exists()
    with data_folder() as other:
        elsewhere = open_store(sqlite_url(other), other, 0, ADDRESS)
        assert elsewhere.snapshots.all() == [record]
        with elsewhere.snapshots.open(JOB) as file:
            (other / "copy").write_bytes(file.read())
        assert (other / "copy").stat().st_size == record.size
        assert len(list(SnapshotReader(other / "copy").verified())) == 3
        assert elsewhere.restoring.restore(other / "copy", "again", NOW).views == 1

        [holding] = store.removals.delete_view(view.id).snapshots
        assert (holding.id, holding.views) == (JOB, 1)

        elsewhere.snapshots.delete(JOB)
        for gone in (elsewhere.snapshots.get, elsewhere.snapshots.delete, store.snapshots.open):
            with pytest.raises(NotFound):
                gone(JOB)
        elsewhere.close()
    assert not [name for name in objects.names() if name.startswith("snapshots/")]


def test_a_receipt_says_so_where_it_cannot_know_what_snapshots_have(store: SqlStore, objects: ObjectStore) -> None:
    first, second = enroll(store, "gate").view, enroll(store, "pond").view
    describe_all(store)
    store.snapshots.make("campus", JOB, NOW, quiet)
    objects.client.delete_object(Bucket=BUCKET, Key=f"{PREFIX}snapshots/{JOB}.digests")
    [holding] = store.removals.delete_view(first.id).snapshots
    assert (holding.id, holding.views) == (JOB, None)

    objects.stop()
    try:
        [holding] = store.removals.delete_view(second.id).snapshots
        assert (holding.id, holding.views) == ("unknown", None)
    finally:
        objects.start()


def test_a_snapshot_that_is_cancelled_while_it_is_sent_is_not_there(
    store: SqlStore, objects: ObjectStore, data: Path
) -> None:
    enroll(store, "gate")
    describe_all(store)
    with pytest.raises(KeyError):
        store.snapshots.make("campus", JOB, NOW, raising(KeyError("cancelled"), after=1))
    assert store.snapshots.all() == []
    assert [one.name for one in (data / "scratch").iterdir()] == [".making"]
    assert store.leftovers is not None
    store.leftovers.sweep(0)
    assert not [name for name in objects.names() if name.startswith("snapshots/")]


def test_doctor_knows_them(store: SqlStore, data: Path) -> None:
    enroll(store, "gate")
    describe_all(store)
    store.snapshots.make("campus", JOB, NOW, quiet)
    kept(store, JOB, b"a recording")
    assert list(examine(sqlite_url(data), data, images=ADDRESS)) == []


def test_scratch_of_a_process_that_was_killed_is_removed_and_that_of_a_living_one_is_not(data: Path) -> None:
    code = (
        "import sys, time; from pathlib import Path; from worker.storage.scratch import Scratch\n"
        "with Scratch(Path(sys.argv[1])).made() as own:\n"
        "    (own / 'upload').write_bytes(b'large'); print('made', flush=True); time.sleep(60)"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(data / "scratch")], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "made\n"
    scratch = Scratch(data / "scratch")
    with scratch.made() as mine:
        scratch.sweep()
        assert mine.is_dir()
        assert len(list((data / "scratch").glob("*/upload"))) == 1
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        scratch.sweep()
        assert [one.name for one in (data / "scratch").iterdir() if one.is_dir()] == [mine.name]
    scratch.sweep()
    assert not any(one.is_dir() for one in (data / "scratch").iterdir())


def test_alone_on_a_folder_nothing_is_copied(data: Path) -> None:
    alone = open_store(sqlite_url(data), data)
    upload = alone.uploads.receive()
    upload.write(b"a recording")
    upload.end()
    inode = upload.path.stat().st_ino
    alone.uploads.keep(upload, JOB, {"every_s": 2.0})
    with alone.uploads.opened(JOB, raising(AssertionError())) as (path, wanted):
        assert (path.stat().st_ino, path, wanted) == (inode, data / "imports" / JOB / "upload", {"every_s": 2.0})
    assert alone.leftovers is None
    assert not (data / "scratch").exists()
    alone.close()
