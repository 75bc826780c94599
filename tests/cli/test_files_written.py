"""Files that commands write: whole, or what was there before stays."""

import os
import resource
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from app.cli.__main__ import main
from app.cli.output import write_file
from tests import answers
from tests.cli.fake_service import FakeService

LARGE = bytes(3_000_000)


@contextmanager
def files_end_at(size: int) -> Iterator[None]:
    """Every write beyond `size` bytes of a file fails, as on a full disk, after part of it was written."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("before", [None, b"an older drawing"])
@pytest.mark.parametrize(
    ("argv", "call"),
    [
        (["query", "{folder}/q.jpg", "--explain", "{folder}/file"], "GET /queries/q1/explanation.png"),
        (["views", "v1", "--image", "{folder}/file"], "GET /views/v1/image"),
        (["changes", "v2", "--since", "v1", "--drawing", "{folder}/file"], "GET /views/v2/changes.png"),
    ],
    ids=["query", "views", "changes"],
)
def test_a_full_disk_leaves_what_was_there(
    service: FakeService,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    argv: list[str],
    call: str,
    before: bytes | None,
) -> None:
    (tmp_path / "q.jpg").write_bytes(b"a picture")
    if before is not None:
        (tmp_path / "file").write_bytes(before)
    there = {path: path.read_bytes() for path in tmp_path.iterdir()}
    same: dict[str, Any] = {
        "status": "compared",
        "detail": None,
        "since": "v1",
        "compared": 1.0,
        "similarity": 1.0,
        "changes": [],
    }
    service.replies |= {
        "POST /query": (200, answers.query_answer(answers.match())),
        "GET /views/v1": (200, answers.view()),
        "GET /views/v2/changes": (200, same | {"links": {}}),
        call: (200, LARGE),
    }

    with files_end_at(1_000_000):
        assert main([part.format(folder=tmp_path) for part in argv]) == 1

    assert f"revisit: {tmp_path / 'file'}: File too large" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == there


def test_a_file_keeps_its_mode_and_links_stay_links(tmp_path: Path) -> None:
    file, link = tmp_path / "why.png", tmp_path / "latest.png"
    file.write_bytes(b"older")
    file.chmod(0o640)
    link.symlink_to("why.png")

    write_file(link, b"newer")

    assert link.is_symlink()
    assert file.read_bytes() == b"newer"
    assert stat.S_IMODE(file.stat().st_mode) == 0o640
    write_file(tmp_path / "another.png", b"")
    umask = os.umask(0)
    os.umask(umask)
    assert stat.S_IMODE((tmp_path / "another.png").stat().st_mode) == 0o666 & ~umask


def test_a_pipe_is_written_to_and_stays_one(tmp_path: Path) -> None:
    pipe, read = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: read.append(pipe.read_bytes()))
    reader.start()
    write_file(pipe, b"a png")
    reader.join()

    assert read == [b"a png"]
    assert pipe.is_fifo()


def test_standard_output_is_written_to_also_where_it_is_a_file(tmp_path: Path) -> None:
    output = tmp_path / "out.png"
    program = "from pathlib import Path; from app.cli.output import write_file as w; w(Path('/dev/stdout'), b'png')"
    with output.open("wb") as file:
        number = os.fstat(file.fileno()).st_ino
        subprocess.run([sys.executable, "-c", program], stdout=file, check=True)

    assert output.read_bytes() == b"png"
    assert output.stat().st_ino == number


def test_a_file_in_a_folder_that_takes_no_new_ones_is_written_in_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "why.png"
    file.write_bytes(b"older")
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != tmp_path)  # root may write anywhere

    write_file(file, b"new")

    assert file.read_bytes() == b"new"
    assert os.listdir(tmp_path) == ["why.png"]
