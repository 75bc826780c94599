"""`revisit doctor` over every kind of damage: one finding a line, never a traceback; `--repair` mends what it can."""

import io
import os
import shutil
import sqlite3
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from PIL import Image as PilImage

from app.cli.__main__ import main
from lab.faults.data_folder import Known, files, make, settings_of
from scenes import scene
from tests.storage.databases import sqlite_url
from tests.storage.material import NOW
from tests.stories.photos import jpeg
from tests.stories.running import ROOT, RunningService
from worker.runtime import build
from worker.storage.locks import lock_for_serving
from worker.storage.repairing import repair

pytestmark = pytest.mark.one_database("it is about SQLite's own file; tests/storage examines rows on both")

NOBODY = "http://127.0.0.1:9"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Known]]:
    """A data folder as a killed service leaves it, and its views."""
    folder = tmp_path_factory.mktemp("made")
    return folder / "base", make(folder / "base", folder / "work")


@pytest.fixture
def data(made: tuple[Path, dict[str, Known]], tmp_path: Path) -> Path:
    """A copy of it whose log was taken over, as after a clean stop."""
    shutil.copytree(made[0], tmp_path / "data")
    with closing(sqlite3.connect(tmp_path / "data" / "revisit.db")) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    return tmp_path / "data"


def doctor(data: Path, capsys: pytest.CaptureFixture[str], *flags: str) -> tuple[int, str]:
    """Exit code and output of the command."""
    code = main(["doctor", "--data", str(data), "--url", NOBODY, *flags])
    told = capsys.readouterr()
    assert "Traceback" not in told.out + told.err
    return code, told.out


def sql(data: Path, statement: str, *values: object) -> None:
    with closing(sqlite3.connect(data / "revisit.db")) as connection, connection:
        assert connection.execute(statement, values).rowcount == 1


def content_of(data: Path) -> dict[Path, bytes]:
    """All files but an empty log, which reading makes."""
    return {path: body for path in files(data) if (body := path.read_bytes()) or not path.name.endswith("-wal")}


def images(data: Path) -> list[Path]:
    return [path for path in files(data) if "pictures" in path.parts]


def test_a_whole_folder_has_no_findings(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, told = doctor(data, capsys)
    assert (code, told.splitlines()[-2:]) == (0, ["findings", "  none"])


def test_a_file_is_no_data_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "photo.jpg").write_bytes(b"")
    code, told = doctor(tmp_path / "photo.jpg", capsys)
    assert (code, f"{tmp_path / 'photo.jpg'}: is no folder that can be read" in told) == (1, True)


def test_it_goes_on_after_the_first_bad_image(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    deleted, damaged, emptied, cut, *_ = images(data)
    deleted.unlink()
    damaged.write_bytes(damaged.read_bytes().replace(b"IDAT", b"IDAU"))
    emptied.write_bytes(b"")
    cut.write_bytes(cut.read_bytes()[:-1])
    orphan = cut.with_name(cut.name[:4] + "0" * 60)
    orphan.write_bytes(b"left by a crash")
    (data / "pictures" / "holiday.jpg").write_bytes(b"of mine")
    code, told = doctor(data, capsys)
    lines = {line.split(":")[0].rpartition("/")[2]: line for line in told.partition("findings")[2].splitlines()}
    assert code == 1
    for path, what in (
        (deleted, "is missing; it is the image of view"),
        (damaged, "does not hold what was enrolled; it is the image of view"),
        (emptied, "is empty; it is the image of view"),
        (cut, "does not hold what was enrolled"),
        (orphan, "does not hold what was enrolled; it is the image of no view"),
        (data / "holiday.jpg", "is not of revisit"),
    ):
        assert what in lines[path.name]


def break_page(data: Path) -> None:
    path = data / "revisit.db"
    body = bytearray(path.read_bytes())
    with closing(sqlite3.connect(path)) as connection:
        (page,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'cells'").fetchone()
    body[(page - 1) * 8192 : (page - 1) * 8192 + 64] = bytes(64)
    path.write_bytes(body)


def truncate(data: Path) -> None:
    os.truncate(data / "revisit.db", 20_000)


def replace_by_letter(data: Path) -> None:
    (data / "revisit.db").write_text("a letter home " * 5000)


def empty(data: Path) -> None:
    (data / "revisit.db").write_bytes(b"")


def remove(data: Path) -> None:
    (data / "revisit.db").unlink()


def make_folder(data: Path) -> None:
    (data / "revisit.db").unlink()
    (data / "revisit.db").mkdir()


def drop_table(data: Path) -> None:
    with closing(sqlite3.connect(data / "revisit.db")) as connection:
        connection.execute("DROP TABLE comparisons")


def damage_log(data: Path) -> None:
    (data / "revisit.db-wal").write_bytes(b"no log" * 5000)


RUINS: dict[str, Callable[[Path], None]] = {
    "corrupt page": break_page,
    "truncated": truncate,
    "no database": replace_by_letter,
    "empty": empty,
    "missing": remove,
    "folder": make_folder,
    "table missing": drop_table,
    "log": damage_log,
    "images gone": lambda data: shutil.rmtree(data / "pictures"),
}


@pytest.mark.parametrize("kind", RUINS)
def test_whatever_is_in_the_folder(kind: str, data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    RUINS[kind](data)
    before = content_of(data)
    code, told = doctor(data, capsys)
    assert code == 1
    assert told.partition("findings\n")[2].strip()
    assert content_of(data) == before, "doctor changed what it looked at"
    code, told = doctor(data, capsys, "--repair")
    assert told.startswith("done\n")


@pytest.mark.parametrize(("revision", "remedy"), [("0022", "./revisit migrate"), ("9999", "run the newer version")])
def test_tables_of_another_version_are_no_damage(
    revision: str, remedy: str, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with closing(sqlite3.connect(data / "revisit.db")) as connection, connection:
        connection.execute("DROP TABLE deleted_images")  # which another version has not, or has no longer
        connection.execute("UPDATE alembic_version SET version_num = ?", [revision])
    before = content_of(data)
    for flags in [], ["--repair"]:
        code, told = doctor(data, capsys, *flags)
        assert (code, told.rpartition("\n  ")[2].endswith(f"{remedy}\n")) == (1, True)
    assert "nothing: there was nothing to mend" in told
    assert content_of(data).items() >= before.items()
    break_page(data)
    before = content_of(data)
    code, told = doctor(data, capsys, "--repair")
    assert (code, f"its tables are at {revision}, which only the version" in told) == (1, True)
    assert content_of(data).items() >= before.items()


def test_a_corrupt_page_costs_what_was_on_it_and_that_is_described_again(
    data: Path, capsys: pytest.CaptureFixture[str], made: tuple[Path, dict[str, Known]]
) -> None:
    break_page(data)
    code, told = doctor(data, capsys, "--repair")
    assert code == 0, told
    assert doctor(data, capsys)[0] == 0
    runtime = build(settings_of(data))
    runtime.start()
    try:
        for view_id, known in made[1].items():
            while runtime.store.jobs.count_waiting(redescriptions=True):
                runtime.settlements.wait(view_id, 1)
            record = runtime.services.views.get(view_id).record
            assert (record.state, record.attributes.place) == ("ready", known.place)
    finally:
        runtime.stop()


def test_a_large_database_is_repaired_without_all_of_it_in_memory(data: Path) -> None:
    with closing(sqlite3.connect(data / "revisit.db")) as connection, connection:
        connection.execute("CREATE TABLE more (body BLOB)")
        connection.execute("INSERT INTO more VALUES (zeroblob(40000000))")
    break_page(data)
    (data / "revisit.db-wal").write_bytes(b"no log" * 7_000_000)
    tracemalloc.start()
    try:
        done, _ = repair(sqlite_url(data), data)
        assert tracemalloc.get_traced_memory()[1] < 20_000_000
    finally:
        tracemalloc.stop()
    assert any("was damaged; what can be read was copied" in line for line in done)
    whole = [path.name[:14] for path in data.glob("revisit.db*.damaged-*") if path.stat().st_size > 40_000_000]
    assert sorted(whole) == ["revisit.db-wal", "revisit.db.dam"]


@pytest.mark.parametrize(
    ("statement", "where"),
    [
        ("UPDATE vectors SET body = zeroblob(4) WHERE seq = 1", "its description"),
        ("UPDATE cells SET checksum = 1 WHERE seq = 2", "its description"),
        ("DELETE FROM appearances WHERE seq = 2", "its description"),
        ("UPDATE descriptions SET nodes = nodes + 1 WHERE seq = 1", "its description"),
        ("UPDATE views SET state = 'reday' WHERE seq = 1", "its state"),
        ("UPDATE views SET state = 'pending' WHERE seq = 1", "is pending"),
        ("UPDATE maps SET ranking = '{}' WHERE name = 'town'", "map 'town'"),
        ("UPDATE maps SET revision = 10000 WHERE name = 'town'", "map 'town'"),
        ("UPDATE maps SET revision = 'ten' WHERE name = 'town'", "map 'town'"),
        ("UPDATE maps SET revision = 9223372036854775807 WHERE name = 'town'", "map 'town'"),
        ("UPDATE descriptions SET revision = 'ten' WHERE seq = 1", "its description"),
        ("UPDATE comparisons SET level = 0.5 WHERE seq = 1", "of comparisons"),
        ("UPDATE jobs SET finished_at = '2020-01-01 00:00:00.000000' WHERE number = 1", "of jobs"),
        ("UPDATE clock SET revision = 0", "clock"),
        ("UPDATE clock SET revision = 'ten'", "clock"),
        ("DELETE FROM metadata_pairs WHERE seq = 1 AND pair = (SELECT min(pair) FROM metadata_pairs)", "metadata"),
    ],
)
def test_damaged_rows_are_found_and_mended(
    statement: str, where: str, data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sql(data, statement)
    code, told = doctor(data, capsys)
    assert code == 1
    assert where in told
    code, told = doctor(data, capsys, "--repair")
    assert (code, where in told) == (0, True)
    assert doctor(data, capsys)[0] == 0


def test_damaged_attributes_cannot_be_mended_and_that_is_said(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sql(data, "UPDATE views SET place = 'hill lane' WHERE seq = 1")
    assert doctor(data, capsys)[0] == 1
    code, told = doctor(data, capsys, "--repair")
    assert code == 1
    assert "its attributes cannot be mended: give them again" in told.partition("\nleft\n")[0]
    assert "enrol its image again, the very file, with its attributes" in told.partition("\nleft\n")[2]


def test_orphans_are_removed_and_repair_waits_for_nobody(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sql(data, "DELETE FROM views WHERE seq = 1")
    service = lock_for_serving(data, NOW)
    code = main(["doctor", "--data", str(data), "--url", NOBODY, "--repair"])
    assert (code, "is served already by process" in capsys.readouterr().err) == (1, True)
    service.release()
    before = len(images(data))
    code, told = doctor(data, capsys, "--repair")
    assert (code, len(images(data))) == (0, before - 1)
    assert "belongs to no view; removed" in told


def test_one_photo_in_three_formats_is_no_fault(tmp_path: Path) -> None:
    """And the examination of a running service says nothing, and disturbs nothing."""
    pixels = PilImage.fromarray(scene("mill lane").pixels)
    with RunningService(tmp_path / "data") as service:
        import httpx

        for kind, extra in (("png", {}), ("bmp", {}), ("webp", {"lossless": True})):
            buffer = io.BytesIO()
            pixels.save(buffer, kind, **extra)
            sent = {"content-type": f"image/{kind}"}
            assert (
                httpx.post(f"{service.url}/enroll", content=buffer.getvalue(), headers=sent, timeout=60).status_code
                == 201
            )
        other = jpeg(scene("rose garden").pixels)
        assert httpx.post(
            f"{service.url}/enroll", content=other, headers={"content-type": "image/jpeg"}, timeout=60
        ).is_success
        command = [sys.executable, "-m", "app.cli", "doctor", "--data", str(service.data), "--url", service.url]
        told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert told.returncode == 0, told.stdout + told.stderr
        assert "4 of 4 images find themselves" in told.stdout
