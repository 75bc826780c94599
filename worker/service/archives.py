"""Zip archives of recordings, from strangers: checked by their directory before anything of them is unpacked."""

import os
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import BinaryIO

from schemas import values
from schemas.errors import BadBody, BodyTooLarge

SUFFIXES = frozenset((".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff", ".heic", ".heif"))
MANIFESTS = ("manifest.csv", "manifest.tsv", "manifest.ndjson", "manifest.jsonl")

MOST_FILES = 50_000
MOST_DIRECTORY_BYTES = 16_000_000
MOST_MANIFEST_BYTES = 64_000_000
MOST_RATIO = 100
"""Bytes unpacked for each byte of the archive; photos have hardly more than 1."""
FREE_BYTES = 10_000_000
"""Bytes that may be unpacked whatever is the ratio."""
LONGEST_NAME = 1024

_DRIVE = re.compile("[A-Za-z]:")  # 9:30.jpg has none
_END = struct.Struct("<4s4H2LH")
_END_64 = struct.Struct("<4sQ2H2L4Q")
_UTF_8 = 0x800  # flag: the name is in UTF-8 (APPNOTE.TXT, 4.4.4)
_LOCATOR = struct.Struct("<4sLQL")


@dataclass(frozen=True)
class Entry:
    """A file of an archive; `size` in bytes, unpacked."""

    name: str
    size: int


class Archive:
    """An archive whose directory is sound.

    Parameters
    ----------
    path : Path
    most_bytes : int
        Bytes of all files, unpacked.

    Attributes
    ----------
    images : list of Entry
        Files with the suffix of an image, by name.
    others : list of Entry
        Files that are neither image nor manifest.
    manifest : Entry or None

    Raises
    ------
    BadBody
        ``malformed-body``: it is no archive, or a hostile one; the text says why.
    BodyTooLarge
    """

    def __init__(self, path: Path, most_bytes: int) -> None:
        with path.open("rb") as file:
            _check_directory(file)
        try:
            self._zip = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError, struct.error) as error:
            raise _refused(f"it cannot be read ({error})") from None
        try:
            self._sort(path.stat().st_size, most_bytes)
        except BaseException:
            self._zip.close()
            raise

    def close(self) -> None:
        """Close its file."""
        self._zip.close()

    def read(self, entry: Entry, most: int) -> bytes:
        """The bytes of a file; raises ValueError when it is damaged or has more than `most` bytes."""
        if entry.size > most:
            raise ValueError(f"has {entry.size:,} bytes; at most {most:,} are taken")
        try:
            return self._zip.read(self._infos[entry.name])
        except (zipfile.BadZipFile, zlib.error, OSError, EOFError, NotImplementedError, struct.error) as error:
            raise ValueError(f"is damaged in the archive ({error})") from None

    def _sort(self, packed: int, most_bytes: int) -> None:
        """Sort the files into images, the manifest and others; raises BadBody, BodyTooLarge."""
        infos = self._zip.infolist()
        if len(infos) > MOST_FILES:
            raise BodyTooLarge(f"the archive has {len(infos):,} files; at most {MOST_FILES:,} are taken")
        seen: set[str] = set()
        self._infos: dict[str, zipfile.ZipInfo] = {}
        self.images: list[Entry] = []
        self.others: list[Entry] = []
        manifests: list[Entry] = []
        for info in infos:
            name = _checked_name(info)
            if name.endswith("/"):
                continue
            if name in seen:
                raise _refused(f"two of its files have the name {name!r}")
            seen.add(name)
            _check_entry(info, name)
            entry = Entry(_name(info), info.file_size)
            self._infos[entry.name] = info
            path = PurePosixPath(name)
            if any(part.startswith(".") or part == "__MACOSX" for part in path.parts):
                continue  # what systems leave in folders
            if path.name.lower() in MANIFESTS:
                manifests.append(entry)
            elif path.suffix.lower() in SUFFIXES:
                self.images.append(entry)
            else:
                self.others.append(entry)
        _check_unpacked(sum(info.file_size for info in infos), packed, most_bytes)
        self.manifest = _only(manifests)
        self.images.sort(key=lambda entry: values.in_order(entry.name))
        if not self.images:
            raise _refused(f"it holds no image ({', '.join(sorted(SUFFIXES))})")


def _refused(why: str) -> BadBody:
    return BadBody("malformed-body", f"the archive is refused: {why}")


def _name(info: zipfile.ZipInfo) -> str:
    """The name as it was meant: `zip` and macOS write UTF-8 without the flag that says so, read here as CP437."""
    if info.flag_bits & _UTF_8:
        return info.filename
    try:
        return info.filename.encode("cp437").decode()
    except UnicodeError:
        return info.filename


def _checked_name(info: zipfile.ZipInfo) -> str:
    """The name with slashes; raises BadBody when it leads out of the archive."""
    name = _name(info)
    if len(name) > LONGEST_NAME:
        raise _refused(f"a name in it has {len(name):,} letters; at most {LONGEST_NAME:,} are taken")
    if "\0" in info.orig_filename or any(ord(letter) < 32 or 0xD800 <= ord(letter) <= 0xDFFF for letter in name):
        raise _refused(f"the name {name[:80]!r} has control characters")
    path = name.replace("\\", "/")
    if path.startswith("/") or _DRIVE.match(path):
        raise _refused(f"the name {name[:80]!r} is absolute")
    if ".." in path.split("/"):
        raise _refused(f"the name {name[:80]!r} leads out of the archive")
    return path


def _check_unpacked(unpacked: int, packed: int, most_bytes: int) -> None:
    """Raise where so many bytes would become too many more, or too many."""
    if unpacked > max(FREE_BYTES, MOST_RATIO * packed):
        raise _refused(
            f"its {packed:,} bytes would become {unpacked:,}, more than {MOST_RATIO} times as many, as no photos do"
        )
    if unpacked > most_bytes:
        raise BodyTooLarge(f"the archive would become {unpacked:,} bytes; at most {most_bytes:,} are taken")


def _only(manifests: Sequence[Entry]) -> Entry | None:
    """The one manifest, if any; raises BadBody where there are several, or it is too large."""
    if len(manifests) > 1:
        raise _refused(f"it has {len(manifests)} manifests, such as {manifests[0].name} and {manifests[1].name}")
    if manifests and manifests[0].size > MOST_MANIFEST_BYTES:
        raise _refused(f"its manifest has {manifests[0].size:,} bytes; at most {MOST_MANIFEST_BYTES:,} are taken")
    return manifests[0] if manifests else None


def _check_entry(info: zipfile.ZipInfo, name: str) -> None:
    kind = stat.S_IFMT(info.external_attr >> 16)
    if kind == stat.S_IFLNK:
        raise _refused(f"{name} is a symbolic link")
    if kind not in (0, stat.S_IFREG):
        raise _refused(f"{name} is not a plain file")
    if info.flag_bits & 0x1:
        raise _refused(f"{name} is encrypted")
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise _refused(f"{name} is packed by method {info.compress_type}; stored and deflated files are taken")


def _check_directory(file: BinaryIO) -> None:
    """Raise unless the directory is small: `zipfile` reads all of it into memory, whatever its end says."""
    size = file.seek(0, os.SEEK_END)
    if size == 0:
        raise _refused("it is empty")
    tail = min(size, _LOCATOR.size + _END.size + 0xFFFF)
    file.seek(size - tail)
    data = file.read(tail)
    at = data.rfind(b"PK\x05\x06")
    if at < 0 or len(data) - at < _END.size:
        raise _refused("it is no zip archive or breaks off before its end, neither a video nor MCAP")
    _, _, _, _, count, length, _, _ = _END.unpack_from(data, at)
    if at >= _LOCATOR.size and data[at - _LOCATOR.size : at].startswith(b"PK\x06\x07"):
        _, _, where, _ = _LOCATOR.unpack_from(data, at - _LOCATOR.size)
        file.seek(min(where, size))
        whole = file.read(_END_64.size)
        if len(whole) < _END_64.size or not whole.startswith(b"PK\x06\x06"):
            raise _refused("its end is damaged")
        count, length = _END_64.unpack(whole)[7], _END_64.unpack(whole)[8]
    if count > MOST_FILES:
        raise BodyTooLarge(f"the archive has {count:,} files; at most {MOST_FILES:,} are taken")
    if length > MOST_DIRECTORY_BYTES:
        raise BodyTooLarge(
            f"the directory of the archive has {length:,} bytes; at most {MOST_DIRECTORY_BYTES:,} are taken"
        )
