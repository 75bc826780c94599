"""Whole files, whatever number of bytes a system takes at a time."""

import os
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from worker.storage import whole_files


@given(st.lists(st.binary(max_size=40), max_size=12), st.integers(1, 5))
def test_what_was_written_is_read(tmp_path_factory: pytest.TempPathFactory, pieces: list[bytes], most: int) -> None:
    path = tmp_path_factory.mktemp("files") / "file"
    with pytest.MonkeyPatch.context() as patched, path.open("xb", buffering=0) as file:
        patched.setattr(whole_files, "MOST_PIECES", most)
        whole_files.write(file.fileno(), pieces)
    assert whole_files.read(path) == b"".join(pieces)


def test_more_pieces_than_one_call_takes(tmp_path: Path) -> None:
    with (tmp_path / "file").open("xb", buffering=0) as file:
        whole_files.write(file.fileno(), [b"ab"] * 5000)
    assert whole_files.read(tmp_path / "file") == b"ab" * 5000


def test_a_folder_or_nothing_is_an_error(tmp_path: Path) -> None:
    before = len(os.listdir("/dev/fd"))
    with pytest.raises(IsADirectoryError):
        whole_files.read(tmp_path)
    with pytest.raises(FileNotFoundError):
        whole_files.read(tmp_path / "nothing")
    assert len(os.listdir("/dev/fd")) <= before, "a file stayed open"
