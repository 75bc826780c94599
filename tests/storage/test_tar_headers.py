"""A header of a part is the one that tarfile makes, and no other is read."""

import tarfile

import pytest
from hypothesis import example, given, strategies as st

from worker.storage.tar_headers import MOST_SIZE, header, parse_header

NAMES = ("snapshot.json", f"images/{'0f' * 32}", "descriptions/000001.bin", "manifest.ndjson", "x" * 100)


@given(name=st.sampled_from(NAMES), size=st.integers(0, MOST_SIZE))
@example(name="views/000012.ndjson", size=MOST_SIZE)
def test_it_is_that_of_tarfile_and_read_back(name: str, size: int) -> None:
    part = tarfile.TarInfo(name)
    part.size, part.mode = size, 0o644

    made = header(name, size)

    assert made == part.tobuf(tarfile.GNU_FORMAT)
    assert parse_header(made) == (name, size)


@given(at=st.integers(0, 511), bits=st.integers(1, 255))
def test_a_changed_byte_anywhere_makes_it_another(at: int, bits: int) -> None:
    changed = bytearray(header("views/000001.ndjson", 12_345))
    changed[at] ^= bits

    assert parse_header(bytes(changed)) is None


@pytest.mark.parametrize("raw", [b"", b"snapshot.json", bytes(512), b"\xff" * 512, header("snapshot.json", 1)[:511]])
def test_what_is_no_header_is_none(raw: bytes) -> None:
    assert parse_header(raw) is None


@pytest.mark.parametrize(("name", "size"), [("a", -1), ("a", MOST_SIZE + 1), ("x" * 101, 0)])
def test_what_no_header_can_tell_is_refused(name: str, size: int) -> None:
    with pytest.raises(ValueError, match="has no header"):
        header(name, size)
