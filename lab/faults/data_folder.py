"""A small data folder to damage, and what lies in it."""

import hashlib
import io
import shutil
import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image as PilImage

from scenes import scene
from schemas.records import Position, ViewAttributes
from schemas.settings import Settings
from worker.runtime import Runtime, build

MAPS = {"town": ("mill lane", "rose garden", "castle park", "fish market"), "harbour": ("pier", "quay", "dock")}
SHAPE = (160, 120)
KEPT = (".lock", "-shm")
"""Ends of the names of files without content: locks, and SQLite's shared memory, which it makes anew."""


@dataclass(frozen=True)
class Known:
    """A view that was enrolled: its map, its place, its image, and the SHA-256 of that."""

    map: str
    place: str
    image: bytes
    sha256: str


def settings_of(data: Path) -> Settings:
    """The service that the study runs: the encoder without weights, nothing in the background but describing."""
    return Settings(data=data, encoder="color", threads=1, compare=False, inline_worker=True)


def photo(name: str) -> bytes:
    """A small PNG of a drawn place."""
    pixels = PilImage.fromarray(np.asarray(scene(name).pixels)).resize(SHAPE)
    buffer = io.BytesIO()
    pixels.save(buffer, "PNG")
    return buffer.getvalue()


def make(folder: Path, work: Path) -> dict[str, Known]:
    """Make a data folder as a killed service leaves it, part of it in the write-ahead log; returns its views by id."""
    known: dict[str, Known] = {}
    for round_, count in enumerate((2, 9)):  # the first ones are in the database itself, the others in its log
        runtime = build(settings_of(work))
        runtime.start()
        try:
            for name, places in MAPS.items():
                for number, place in enumerate(places[:count] if round_ == 0 else places[2:]):
                    known |= _enrol(runtime, name, place, 7.5 * number)
            runtime.comparer.all()
            if round_ == 1:
                shutil.copytree(work, folder, ignore=shutil.ignore_patterns(*(f"*{end}" for end in KEPT)))
        finally:
            runtime.stop()
    return known


def _enrol(runtime: Runtime, name: str, place: str, x: float) -> dict[str, Known]:
    image = photo(place)
    attributes = ViewAttributes(place=place, position=Position(x=x, y=1.0), metadata={"colour": "red", "floor": 2})
    outcome = runtime.services.enroll.enroll(image, name, attributes, patience_s=60)
    return {outcome.view.id: Known(name, place, image, hashlib.sha256(image).hexdigest())}


def content(data: Path) -> tuple[object, ...]:
    """All rows of all tables and all images, comparable; raises what SQLite raises when it cannot be read."""
    scratch = data.with_name(data.name + "-read")
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir()
    for path in data.glob("revisit.db*"):
        shutil.copy(path, scratch)
    rows: list[object] = []
    try:
        with closing(sqlite3.connect(scratch / "revisit.db")) as connection:
            connection.text_factory = bytes
            tables = [
                row[0].decode() for row in connection.execute("SELECT name FROM sqlite_master WHERE type='table'")
            ]
            rows.append(sorted(map(repr, connection.execute("SELECT type, name, tbl_name, sql FROM sqlite_master"))))
            rows += [
                (table, sorted(map(repr, connection.execute(f'SELECT * FROM "{table}" NOT INDEXED'))))
                for table in tables
            ]
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    images = {path.relative_to(data): path.read_bytes() for path in files(data) if "pictures" in path.parts}
    return repr(rows), tuple(sorted((str(name), hashlib.sha256(image).digest()) for name, image in images.items()))


def files(data: Path) -> list[Path]:
    """Files of a data folder that have content, sorted."""
    return sorted(path for path in data.rglob("*") if path.is_file() and not path.name.endswith(KEPT))
