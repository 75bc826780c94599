"""Checksums of SQLite's log, as its file format says them."""

import sqlite3
from contextlib import closing
from pathlib import Path
from struct import Struct
from typing import Literal

import pytest
from hypothesis import given, strategies as st

from worker.storage import wal

NUMBERS = st.integers(0, 2**32 - 1)


@given(words=st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=60), sums=st.tuples(NUMBERS, NUMBERS))
@pytest.mark.parametrize("order", ["big", "little"])
def test_the_sums_are_those_that_the_format_describes(
    order: Literal["big", "little"], words: list[tuple[int, int]], sums: tuple[int, int]
) -> None:
    """https://sqlite.org/fileformat2.html, section 4.2: two words at a time."""
    first, second = sums
    for one, other in words:
        first = (first + one + second) % 2**32
        second = (second + other + first) % 2**32
    data = b"".join(word.to_bytes(4, order) for pair in words for word in pair)
    assert wal._sums(data, sums, order) == (first, second)


@pytest.mark.parametrize("page", [512, 8192, 65536])
def test_a_log_that_sqlite_wrote_is_whole_and_a_changed_byte_in_it_is_found(page: int, tmp_path: Path) -> None:
    path = tmp_path / "rows.db"
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        connection.execute(f"PRAGMA page_size={page}")
        connection.execute("PRAGMA journal_mode=WAL").close()
        connection.execute("CREATE TABLE rows (number INTEGER, body BLOB)")
        for number in range(5):
            connection.execute("INSERT INTO rows VALUES (?, randomblob(3000))", (number,))
        log = tmp_path / "rows.db-wal"
        copied = tmp_path / "copied-wal"
        body = bytearray(log.read_bytes())
        copied.write_bytes(body)
        assert wal.fault(copied) is None
        body[32 + 24 + Struct(">I").size] ^= 1  # of the first page
        copied.write_bytes(body)
        assert "frame 1 of" in str(wal.fault(copied))
