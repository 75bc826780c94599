"""The file of a snapshot: a tar that can be written in one way only, so that a changed byte anywhere is found.

Its parts, in this order::

    snapshot.json             what it is: `schemas.snapshot.SnapshotFacts`
    vocabulary.safetensors    unless the vocabulary is one that revisit brings along
    images/<SHA-256>          images of a portion of views, then
    descriptions/000001.bin   bodies of their descriptions, one after another, then
    views/000001.ndjson       these views, one a line, with the sizes of these bodies; and so on
    comparisons/000001.ndjson
    manifest.ndjson           name, size and SHA-256 of every part before it, one a line
    manifest.sha256           that of manifest.ndjson

Nothing is compressed, and no name is used as a path. In version 1 the lines of views have the bodies, in Base64.
"""

import hashlib
import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from tempfile import TemporaryFile
from typing import BinaryIO, Literal, Protocol

from pydantic import ValidationError

from schemas.errors import BadSnapshot
from schemas.snapshot import FORMAT, VERSION, SnapshotFacts, SnapshotPart
from worker.storage.one_thread import OneThread
from worker.storage.tar_headers import BLOCK, END, header, padding, parse_header
from worker.storage.uncached_file import UncachedFile

FACTS, VOCABULARY, MANIFEST, SEAL = "snapshot.json", "vocabulary.safetensors", "manifest.ndjson", "manifest.sha256"
IMAGE, BODIES, VIEWS, COMPARISONS = "images/", "descriptions/", "views/", "comparisons/"

MOST_FACTS = 16 * 1024 * 1024
MOST_PART = 1024 * 1024 * 1024
"""Bytes of the largest part: each is read into memory whole."""

MOST_WAITING = 32 * 1024 * 1024
"""Bytes of parts that wait to be written: some portion of views."""

_SLACK = 64
"""Spaces after the facts, for the digits of counts that are known at the end."""

_DIGEST = re.compile(rb'"elapsed_us":[0-9]+,"sha256":"([0-9a-f]{64})"')
"""Of the image of a view, in its line."""

_NAME = re.compile(
    r"snapshot\.json|vocabulary\.safetensors|images/[0-9a-f]{64}|descriptions/[0-9]{6,9}\.bin"
    r"|(?:views|comparisons)/[0-9]{6,9}\.ndjson"
    r"|manifest\.ndjson|manifest\.sha256"
)


@dataclass(frozen=True)
class Part:
    """A part that was read.

    Parameters
    ----------
    name : str
    body : bytes
    bodies : bytes
        Of a part of views: what the part of descriptions before it has.
    """

    name: str
    body: bytes
    bodies: bytes = b""


class SnapshotWriter:
    """Writes the parts of a snapshot in a thread beside; `end` makes it complete and durable.

    What goes wrong with a part, a full disk for one, is raised by a later call.

    Parameters
    ----------
    file : UncachedFile
        Empty.
    facts : SnapshotFacts
        With counts that may still change.
    """

    def __init__(self, file: UncachedFile, facts: SnapshotFacts) -> None:
        self._file = file
        self._thread = OneThread("snapshot", MOST_WAITING)
        self._lines = TemporaryFile(dir=file.folder)  # noqa: SIM115 (a container may have no /tmp)
        self._numbers: dict[str, int] = {}
        self._facts_size = len(_as_bytes(facts)) + _SLACK
        self.image_bytes = self.row_bytes = 0
        self._file.write(_framed(FACTS, bytes(self._facts_size)))

    def add(self, name: str, pieces: Sequence[bytes]) -> None:
        """Append a part."""
        size = sum(map(len, pieces))
        self._thread.do(size, partial(self._add, name, pieces, size))
        self.row_bytes += size

    def add_images(self, images: Sequence[tuple[str, bytes]]) -> None:
        """Append images, by their SHA-256."""
        size = sum(len(image) for _, image in images)
        self._thread.do(size, partial(self._add_images, images))
        self.image_bytes += size

    def add_views(self, lines: Sequence[bytes], bodies: Sequence[bytes]) -> None:
        """Append the lines of views, and before them the bodies of their descriptions."""
        if bodies:
            self.add(f"{BODIES}{self._numbers.get(VIEWS, 0) + 1:06}.bin", bodies)
        self.add_lines(VIEWS, lines)

    def add_lines(self, kind: str, lines: Sequence[bytes]) -> None:
        """Append lines as the next part of a kind; nothing when there are none."""
        if lines:
            self._numbers[kind] = self._numbers.get(kind, 0) + 1
            self.add(f"{kind}{self._numbers[kind]:06}.ndjson", lines)

    def end(self, facts: SnapshotFacts) -> None:
        """Write the facts as they are now and the manifest; wait until all is on the disk."""
        self._thread.finish()
        first = _as_bytes(facts).ljust(self._facts_size)
        if len(first) != self._facts_size:
            raise ValueError("the facts grew by more than their counts")
        self._file.replace(BLOCK, first)
        opening = _manifest_line(FACTS, hashlib.sha256(first).hexdigest(), len(first))
        size = len(opening) + self._lines.tell()
        seal = hashlib.sha256()
        self._file.write([header(MANIFEST, size)])
        self._file.write([opening], seal)
        self._lines.seek(0)
        while chunk := self._lines.read(1 << 20):
            self._file.write([chunk], seal)
        self._file.write([padding(size), *_framed(SEAL, seal.hexdigest().encode()), END])
        self._file.sync()

    def close(self) -> None:
        """Stop writing, and give up what is kept besides the file."""
        self._thread.close()
        self._lines.close()

    def _add(self, name: str, pieces: Sequence[bytes], size: int) -> None:
        digest = hashlib.sha256()
        self._file.write([header(name, size)])
        self._file.write(pieces, digest)
        self._file.write([padding(size)])
        self._lines.write(_manifest_line(name, digest.hexdigest(), size))

    def _add_images(self, images: Sequence[tuple[str, bytes]]) -> None:
        for digest, image in images:
            self._file.write(_framed(f"{IMAGE}{digest}", image))
        self._lines.writelines(_manifest_line(f"{IMAGE}{digest}", digest, len(image)) for digest, image in images)


def _framed(name: str, body: bytes) -> tuple[bytes, bytes, bytes]:
    """A part with its header and what follows it."""
    return header(name, len(body)), body, padding(len(body))


def _as_bytes(facts: SnapshotFacts) -> bytes:
    return facts.model_dump_json().encode()


def _manifest_line(name: str, digest: str, size: int) -> bytes:
    """The line of a `SnapshotPart`; a snapshot has as many as images."""
    return b'{"name":"%b","sha256":"%b","size":%d}\n' % (name.encode(), digest.encode(), size)


class Source(Protocol):
    """A file, wherever it lies: a path, for one."""

    def open(self, mode: Literal["rb"]) -> BinaryIO:
        """Open it for reading."""
        ...


class SnapshotReader:
    """Reads a snapshot: once to verify it, and then the parts that are wanted.

    A part that changed between the two is refused like one that never fitted the manifest.

    Parameters
    ----------
    path : Source
    """

    def __init__(self, path: Source) -> None:
        self._path = path
        self._digests = bytearray()  # of the parts in their order, once verified

    def facts(self) -> SnapshotFacts:
        """What the snapshot is, by its first part alone; raises BadSnapshot."""
        with self._path.open("rb") as file:
            name, size = _read_header(file)
            if name != FACTS or size > MOST_FACTS:
                raise BadSnapshot(f"it begins with {name}, not with {FACTS}: it is no snapshot of revisit")
            return _facts(_read(file, size, FACTS))

    def verified(self) -> Iterator[Part]:
        """Read all parts before the manifest, those of descriptions with their views, then compare all bytes with it.

        Nothing may be kept of what this gave before it has come to its end without BadSnapshot.
        """
        self._digests.clear()
        lines = hashlib.sha256()
        line_digests = bytearray()
        numbers: dict[str, int] = {}
        seen_facts, bodies = False, b""
        with self._path.open("rb") as file:
            while True:
                name, size = _read_header(file)
                if name == MANIFEST:
                    break
                _check_order(name, seen_facts, numbers)
                seen_facts = True
                if size > MOST_PART:
                    raise BadSnapshot(f"its part {name} has {size:,} bytes; at most {MOST_PART:,} are taken")
                body = _read(file, size, name)
                digest = hashlib.sha256(body)
                if name.startswith(IMAGE) and digest.hexdigest() != name.removeprefix(IMAGE):
                    raise BadSnapshot(f"the bytes of {name} are not those of its name: it was changed or damaged")
                line = _manifest_line(name, digest.hexdigest(), size)
                lines.update(line)
                line_digests += hashlib.sha256(line).digest()
                self._digests += digest.digest()
                if name.startswith(BODIES):
                    bodies = body
                elif name.startswith(VIEWS):
                    yield Part(name, body, bodies)
                    bodies = b""
                else:
                    yield Part(name, body)
            if bodies:
                raise BadSnapshot("its last descriptions are of no views")
            _check_manifest(file, size, lines.digest(), line_digests)
            name, size = _read_header(file)
            if name != SEAL or size != 64 or _read(file, size, name) != lines.hexdigest().encode():
                raise BadSnapshot(f"its {MANIFEST} does not have the SHA-256 of {SEAL}: one of them was changed")
            if file.read(len(END) + 1) != END:
                raise BadSnapshot("something stands behind its end, or the end is cut off")

    def digests(self) -> frozenset[bytes]:
        """SHA-256 of the images of all views, also of those whose image is not in it; nothing is verified.

        Raises
        ------
        BadSnapshot
        """
        found: set[bytes] = set()
        keeps_images = self.facts().keep_images
        with self._path.open("rb") as file:
            while True:
                name, size = _read_header(file)
                if name == MANIFEST:
                    return frozenset(found)
                if name.startswith(IMAGE):
                    found.add(bytes.fromhex(name.removeprefix(IMAGE)))
                elif name.startswith(VIEWS) and not keeps_images:
                    if size > MOST_PART:
                        raise BadSnapshot(f"its part {name} has {size:,} bytes; at most {MOST_PART:,} are taken")
                    body = _read(file, size, name)
                    found.update(bytes.fromhex(digest.decode()) for digest in _DIGEST.findall(body))
                    continue
                file.seek(size + len(padding(size)), os.SEEK_CUR)

    def parts(self, kind: str) -> Iterator[Part]:
        """Read the parts of a kind again, views with their descriptions, each compared with what was verified."""
        wanted, bodies = (kind, BODIES) if kind == VIEWS else (kind,), b""
        with self._path.open("rb") as file:
            for at in range(0, len(self._digests), 32):
                name, size = _read_header(file)
                if not name.startswith(wanted):
                    file.seek(size + len(padding(size)), os.SEEK_CUR)
                    continue
                body = _read(file, size, name)
                if hashlib.sha256(body).digest() != self._digests[at : at + 32]:
                    raise BadSnapshot(f"its part {name} changed while it was read")
                if name.startswith(BODIES):
                    bodies = body
                    continue
                yield Part(name, body, bodies)
                bodies = b""


def _read_header(file: BinaryIO) -> tuple[str, int]:
    """Name and size of the next part; raises BadSnapshot for any header that is not written so here."""
    raw = file.read(BLOCK)
    name, size = parse_header(raw) or ("", 0)
    if not _NAME.fullmatch(name):
        where = file.tell() - len(raw)
        if where == 0:
            raise BadSnapshot("it is no snapshot of revisit, or its first bytes are damaged")
        what = "it ends" if len(raw) < BLOCK else "there is something else than a part of a snapshot"
        raise BadSnapshot(f"{what} at byte {where:,}: it was cut off, changed or damaged")
    return name, size


def _read(file: BinaryIO, size: int, name: str) -> bytes:
    """The body of a part, whose padding has to be zeros."""
    body = file.read(size)
    after = padding(size)
    if len(body) != size or file.read(len(after)) != after:
        raise BadSnapshot(f"its part {name} is cut off, or changed behind its end")
    return body


def _check_order(name: str, seen_facts: bool, numbers: dict[str, int]) -> None:
    kind = name.partition("/")[0]
    ordered = {FACTS: 0, VOCABULARY: 1, "images": 2, "descriptions": 2, "views": 2, "comparisons": 3}
    last = numbers.get("order", 0)
    if kind not in ordered or ordered[kind] < last or (kind == FACTS) == seen_facts:
        raise BadSnapshot(f"its part {name} is not where it belongs")
    if kind in ("descriptions", "views", "comparisons"):
        number = numbers.get("views" if kind == "descriptions" else kind, 0) + 1
        if name.partition("/")[2].partition(".")[0] != f"{number:06}" or numbers.get(kind) == number:
            raise BadSnapshot(f"its part {name} stands where number {number} belongs")
        numbers[kind] = number
    if kind == VOCABULARY and last == ordered[VOCABULARY]:
        raise BadSnapshot(f"it has a second {name}")
    numbers["order"] = ordered[kind]


def _check_manifest(file: BinaryIO, size: int, whole: bytes, lines: bytearray) -> None:
    """Compare the manifest with the parts, and name the first part that differs."""
    left, seal = size, hashlib.sha256()
    number = 0
    fault = None
    while left > 0:
        line = file.readline(min(left, 4096))
        if not line:
            raise BadSnapshot(f"its {MANIFEST} is cut off")
        left -= len(line)
        seal.update(line)
        if fault is None and hashlib.sha256(line).digest() != lines[32 * number : 32 * number + 32]:
            fault = line
        number += 1
    if fault is not None or seal.digest() != whole:
        try:
            named = SnapshotPart.model_validate_json(fault or b"").name
        except ValidationError:
            named = MANIFEST
        raise BadSnapshot(f"its part {named} does not have the size and SHA-256 of the manifest: it was changed")
    after = padding(size)
    if file.read(len(after)) != after:
        raise BadSnapshot(f"its part {MANIFEST} is changed behind its end")


def _facts(body: bytes) -> SnapshotFacts:
    try:
        stated = json.loads(body)
        form, version = stated["format"], stated["version"]
    except (ValueError, KeyError, TypeError, RecursionError):
        raise BadSnapshot(f"its part {FACTS} cannot be read: it is no snapshot of revisit, or damaged") from None
    if form != FORMAT or version not in range(1, VERSION + 1):
        raise BadSnapshot(
            f"it is of the format {form!r}, version {version!r}; this program reads {FORMAT!r} up to {VERSION}"
        )
    try:
        return SnapshotFacts.model_validate_json(body)
    except ValidationError as error:
        first = error.errors()[0]
        raise BadSnapshot(f"its part {FACTS} is wrong in {'.'.join(map(str, first['loc']))}: {first['msg']}") from None
