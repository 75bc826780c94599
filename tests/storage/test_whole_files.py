"""Whole files, whatever number of bytes a system takes at a time."""

import os
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from worker.storage import whole_files


@given(st.binary(max_size=200), st.integers(1, 50))
def test_what_was_written_is_read(tmp_path_factory: pytest.TempPathFactory, body: bytes, most: int) -> None:
    path = tmp_path_factory.mktemp("files") / "file"
    write = os.write
    with pytest.MonkeyPatch.context() as patched, path.open("xb", buffering=0) as file:
        patched.setattr(os, "write", lambda handle, rest: write(handle, rest[:most]))
        whole_files.write(file.fileno(), body)
    assert whole_files.read(path) == body


def test_a_folder_or_nothing_is_an_error(tmp_path: Path) -> None:
    before = len(os.listdir("/dev/fd"))
    with pytest.raises(IsADirectoryError):
        whole_files.read(tmp_path)
    with pytest.raises(FileNotFoundError):
        whole_files.read(tmp_path / "nothing")
    assert len(os.listdir("/dev/fd")) <= before, "a file stayed open"
